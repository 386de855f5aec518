//! Grippers on a port opened by Python: the host's drivers, with their bytes going through pyserial.

use crate::errors::{GripperError, ToPython, raise};
use crate::tree;
use gelstereo_host::gripper::{self as host, GripperConfig, line::Line};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyMapping};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Exception raised by a Python port, kept until the driver has returned.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// A byte stream over an object with `write(bytes)`, `read(size)`, `timeout` and `in_waiting`, like
/// pyserial's ports.
struct PythonLine {
    port: Py<PyAny>,
    name: String,
    raised: Raised,
}

impl PythonLine {
    fn call<T>(&self, act: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>) -> Result<T, host::GripperError> {
        Python::attach(|py| {
            act(self.port.bind(py)).map_err(|error| {
                let message = error.to_string();
                *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                host::GripperError::Port { port: self.name.clone(), message }
            })
        })
    }
}

impl Line for PythonLine {
    fn send(&mut self, bytes: &[u8]) -> Result<(), host::GripperError> {
        self.call(|port| port.call_method1("write", (PyBytes::new(port.py(), bytes),)).map(|_| ()))
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> Result<usize, host::GripperError> {
        let wait_s = deadline.saturating_duration_since(Instant::now()).as_secs_f64();
        let received: Vec<u8> = self.call(|port| {
            // Waiting in Rust would block Ctrl-C.
            port.py().check_signals()?;
            port.setattr("timeout", wait_s)?;
            let waiting: usize = port.getattr("in_waiting")?.extract()?;
            port.call_method1("read", (waiting.clamp(1, buffer.len()),))?.extract()
        })?;
        let count = received.len().min(buffer.len());
        buffer[..count].copy_from_slice(&received[..count]);
        Ok(count)
    }

    fn name(&self) -> &str {
        &self.name
    }
}

/// A gripper on an open port, created by ``gelstereo.grippers.open``.
#[pyclass(module = "gelstereo.grippers")]
pub struct GripperDriver {
    /// Never locked, because every method has exclusive access. A class shared between Python threads
    /// must be `Sync`.
    driver: Mutex<Box<dyn host::Gripper + Send>>,
    raised: Raised,
}

/// Width and state of a gripper.
#[pyclass(frozen, module = "gelstereo.grippers", get_all)]
pub struct GripperStatus {
    /// Opening width between the pads.
    width_mm: f64,
    /// Whether the fingers are moving.
    moving: bool,
    /// Whether the fingers were stopped by an object between them.
    object_detected: bool,
}

#[pymethods]
impl GripperStatus {
    fn __repr__(&self) -> String {
        let Self { width_mm, moving, object_detected } = self;
        let [moving, object_detected] =
            [moving, object_detected].map(|on| if *on { "True" } else { "False" });
        format!("GripperStatus(width_mm={width_mm:.3}, moving={moving}, object_detected={object_detected})")
    }
}

#[pymethods]
impl GripperDriver {
    /// Settings are those of the table ``[gripper]``; ``port`` has ``write``, ``read``, ``timeout`` and
    /// ``in_waiting``.
    #[new]
    fn new(settings: &Bound<'_, PyMapping>, port: Py<PyAny>, name: String) -> PyResult<Self> {
        let config: GripperConfig = tree::from_mapping(settings).map_err(GripperError::new_err)?;
        let raised = Raised::default();
        let line = PythonLine { port, name, raised: Arc::clone(&raised) };
        let driver = config.driver(Box::new(line)).map_err(raise)?.ok_or_else(|| {
            GripperError::new_err(
                "kind is \"simulated\"; valid is the kind of a real gripper, such as \"robotiq\"",
            )
        })?;
        Ok(Self { driver: Mutex::new(driver), raised })
    }

    /// Start to activate the gripper; returns at once. Some grippers sweep their fingers unless they are
    /// already active. A gripper that holds an object is refused.
    fn activate(&mut self) -> PyResult<()> {
        let result = self.driver().activate();
        self.result(result)
    }

    /// Start to move; returns at once. ``force`` is a fraction of the gripper's range, 0 to 1.
    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> PyResult<()> {
        let result = self.driver().move_to(width_mm, speed_mm_s, force);
        self.result(result)
    }

    /// Stop the fingers in place.
    fn stop(&mut self) -> PyResult<()> {
        let result = self.driver().stop();
        self.result(result)
    }

    /// Present width and state.
    fn status(&mut self) -> PyResult<GripperStatus> {
        let result = self.driver().status();
        let host::GripperStatus { width_mm, moving, object_detected } = self.result(result)?;
        Ok(GripperStatus { width_mm, moving, object_detected })
    }
}

impl GripperDriver {
    fn driver(&mut self) -> &mut dyn host::Gripper {
        self.driver.get_mut().unwrap_or_else(PoisonError::into_inner).as_mut()
    }

    /// The port's exception, for example KeyboardInterrupt, takes precedence over the driver's error.
    fn result<T>(&self, result: Result<T, host::GripperError>) -> PyResult<T> {
        let raised = self.raised.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (result, raised) {
            (Ok(value), _) => Ok(value),
            (Err(_), Some(error)) => Err(error),
            (Err(error), None) => Err(error.to_python()),
        }
    }
}
