//! Random numbers of the simulator's streams.

use crate::errors::ShapeError;
use gelstereo_core::math::random::Stream;
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A stream of random numbers with the same bits on every machine, keyed by seed and name.
///
/// Parameters
/// ----------
/// seed : int
///     0 to 2^64 - 1.
/// name : str
///     Streams of other names are independent.
#[pyclass(frozen, module = "gelstereo._native")]
pub struct RandomStream {
    stream: Mutex<Stream>,
}

#[pymethods]
impl RandomStream {
    #[new]
    fn new(seed: u64, name: &str) -> Self {
        Self { stream: Mutex::new(Stream::new(seed, name)) }
    }

    /// Uniform in [0, 1).
    fn uniform(&self) -> f64 {
        self.lock().uniform()
    }

    /// A number from `low` to `high`, whose logarithm is uniform.
    ///
    /// Raises
    /// ------
    /// ShapeError
    ///     Unless 0 < low <= high.
    fn log_uniform(&self, low: f64, high: f64) -> PyResult<f64> {
        if !(0.0 < low && low <= high && high.is_finite()) {
            return Err(ShapeError::new_err(format!(
                "the range is {low} to {high}; valid is 0 < low <= high"
            )));
        }
        Ok(self.lock().log_uniform(low, high))
    }

    /// A standard normal number.
    fn normal(&self) -> f64 {
        self.lock().normal()
    }

    /// A whole number below `count`.
    ///
    /// Raises
    /// ------
    /// ShapeError
    ///     If `count` is 0.
    fn below(&self, count: usize) -> PyResult<usize> {
        match count {
            0 => Err(ShapeError::new_err("no whole number is below 0; valid is a count from 1")),
            _ => Ok(self.lock().below(count)),
        }
    }
}

impl RandomStream {
    fn lock(&self) -> MutexGuard<'_, Stream> {
        self.stream.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
