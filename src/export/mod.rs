//! Every file a result is written to.
