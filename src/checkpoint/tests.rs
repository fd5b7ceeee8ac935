//! Journals that were cut, flipped and mistaken.
