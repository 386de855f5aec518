//! Nearest-neighbour search: a grid for points in the plane, a k-d tree for points in space; points in rows.

mod grid;
mod kd_tree;
pub(crate) mod rows;

pub(crate) use grid::Grid;
pub use kd_tree::KdTree;
pub(crate) use kd_tree::LEAF;
