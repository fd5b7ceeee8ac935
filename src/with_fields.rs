//! Builders: methods of an options struct that set one field each and give the rest back as it was.

/// Declares `fn with_FIELD(self, FIELD: impl Into<TYPE>) -> Self` for fields of a struct; a field that is an `Option` takes
/// the value itself or `None`.
macro_rules! with_fields {
    ($name:ident { $($with:ident($field:ident: $type:ty)),+ $(,)? }) => {
        impl $name {
            $(
                #[doc = concat!("Sets [`", stringify!($field), "`](Self#structfield.", stringify!($field), ").")]
                #[must_use]
                pub fn $with(mut self, $field: impl Into<$type>) -> Self {
                    self.$field = $field.into();
                    self
                }
            )+
        }
    };
}
pub(crate) use with_fields;
