//! Nearest neighbours: of points in the plane by a grid, of points in space by a k-d tree.

mod grid;
mod kd_tree;

pub(crate) use grid::Grid;
pub use kd_tree::KdTree;
pub(crate) use kd_tree::LEAF;
