//! Names of values that Python gets as numbers.

/// The name of a value in a list of all of them.
pub fn name<T: Copy + PartialEq>(all: &[(&'static str, T)], value: T) -> &'static str {
    all.iter().find(|(_, other)| *other == value).map_or("", |(name, _)| name)
}
