//! Ways to search an image: whole, at half resolution, and near expected positions.

pub(super) mod half;
pub(super) mod whole;
pub(super) mod windows;
