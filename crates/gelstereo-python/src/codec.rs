//! Codecs of HID devices: commands to bytes, and bytes to responses. `gelstereo.hid` transfers them with
//! hidapi.

use crate::errors::{HidError, raise};
use gelstereo_host::codec::blink1::{self, Command, Led, Rgb, Version};
use gelstereo_host::codec::tara::{
    self, Assembly, CalibrationFile, Exposure, Packet, Reply, Request, StreamMode,
};
use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// A command to an e-con Tara camera.
#[pyclass(frozen, module = "gelstereo.hid")]
pub struct TaraRequest(Request);

fn exposure(us: i64) -> PyResult<Exposure> {
    let Ok(us) = u32::try_from(us) else {
        return Err(HidError::new_err(format!("exposure_us is {us}; valid is {}", Exposure::VALID)));
    };
    Exposure::from_us(us).map_err(raise)
}

fn stream_mode(name: &str) -> PyResult<StreamMode> {
    match name {
        "trigger" => Ok(StreamMode::Trigger),
        "master" => Ok(StreamMode::Master),
        _ => Err(HidError::new_err(format!("mode is {name:?}; valid is \"master\" or \"trigger\""))),
    }
}

fn calibration_file(name: &str) -> PyResult<CalibrationFile> {
    match name {
        "intrinsic" => Ok(CalibrationFile::Intrinsic),
        "extrinsic" => Ok(CalibrationFile::Extrinsic),
        _ => Err(HidError::new_err(format!("file is {name:?}; valid is \"intrinsic\" or \"extrinsic\""))),
    }
}

#[pymethods]
impl TaraRequest {
    /// USB vendor of e-con Systems.
    #[classattr]
    const VENDOR: u16 = tara::VENDOR;
    /// USB product of the Tara.
    #[classattr]
    const PRODUCT: u16 = tara::PRODUCT;
    /// Length of the report descriptor of the control interface.
    #[classattr]
    const CONTROL_DESCRIPTOR_BYTES: usize = tara::CONTROL_DESCRIPTOR_BYTES;

    /// Read the firmware version; the answer is a str.
    #[staticmethod]
    fn firmware() -> Self {
        Self(Request::Firmware)
    }

    /// Read the unique number of this camera; the answer is an int.
    #[staticmethod]
    fn unique_id() -> Self {
        Self(Request::UniqueId)
    }

    /// Read the exposure; the answer is an int, microseconds, or 1 for automatic.
    #[staticmethod]
    fn exposure() -> Self {
        Self(Request::Exposure)
    }

    /// Set the exposure, microseconds: 10 to 1000000, or 1 for automatic. The answer is as for ``exposure``.
    #[staticmethod]
    fn set_exposure(exposure_us: i64) -> PyResult<Self> {
        Ok(Self(Request::SetExposure(exposure(exposure_us)?)))
    }

    /// Read the source of the frame trigger; the answer is "master" (the camera's clock) or "trigger".
    #[staticmethod]
    fn stream_mode() -> Self {
        Self(Request::StreamMode)
    }

    /// Set the source of the frame trigger: "master" or "trigger".
    #[staticmethod]
    fn set_stream_mode(mode: &str) -> PyResult<Self> {
        Ok(Self(Request::SetStreamMode(stream_mode(mode)?)))
    }

    /// Read whether high dynamic range is on; the answer is a bool.
    #[staticmethod]
    fn hdr() -> Self {
        Self(Request::Hdr)
    }

    /// Switch high dynamic range on or off.
    #[staticmethod]
    fn set_hdr(on: bool) -> Self {
        Self(Request::SetHdr(on))
    }

    /// Read the length of a calibration file, "intrinsic" or "extrinsic"; the answer is an int, bytes.
    #[staticmethod]
    fn calibration_length(file: &str) -> PyResult<Self> {
        Ok(Self(Request::CalibrationLength(calibration_file(file)?)))
    }

    /// Read a calibration file, "intrinsic" or "extrinsic"; each answer is a packet, (number, 56 bytes).
    #[staticmethod]
    fn calibration_data(file: &str) -> PyResult<Self> {
        Ok(Self(Request::CalibrationData(calibration_file(file)?)))
    }

    /// The report to send, 64 bytes; a transport puts the report number 0 before it.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.0.encode().map_err(raise)?))
    }

    /// Description of the command, for error messages.
    #[getter]
    fn name(&self) -> &'static str {
        self.0.name()
    }

    /// Longest time for the camera's answer, seconds.
    #[getter]
    fn timeout_s(&self) -> f64 {
        self.0.timeout().as_secs_f64()
    }

    /// Decode a report that arrived after the command was sent.
    ///
    /// Parameters
    /// ----------
    /// report : bytes
    ///
    /// Returns
    /// -------
    /// The answer, or None if the report does not answer this command.
    ///
    /// Raises
    /// ------
    /// HidError
    ///     If the camera refused the command, or sent a value without meaning.
    fn decode(&self, py: Python<'_>, report: &[u8]) -> PyResult<Option<Py<PyAny>>> {
        let Some(reply) = self.0.decode(report).map_err(raise)? else {
            return Ok(None);
        };
        let object = match reply {
            Reply::Firmware(firmware) => firmware.to_string().into_py_any(py),
            Reply::UniqueId(number) => number.into_py_any(py),
            Reply::Exposure(exposure) => exposure.us().into_py_any(py),
            Reply::StreamMode(StreamMode::Master) => "master".into_py_any(py),
            Reply::StreamMode(StreamMode::Trigger) => "trigger".into_py_any(py),
            Reply::Hdr(on) => on.into_py_any(py),
            Reply::CalibrationLength(bytes) => bytes.into_py_any(py),
            Reply::CalibrationData(Packet { number, data }) => {
                (number, PyBytes::new(py, &data)).into_py_any(py)
            }
        };
        object.map(Some)
    }
}

/// A calibration file of a Tara, assembled from its packets.
///
/// Parameters
/// ----------
/// length : int
///     Bytes of the file, 0 to 65535.
#[pyclass(module = "gelstereo.hid")]
pub struct TaraAssembly(Assembly);

#[pymethods]
impl TaraAssembly {
    #[new]
    fn new(length: u16) -> Self {
        Self(Assembly::new(length))
    }

    /// Whether all bytes have arrived.
    #[getter]
    fn is_complete(&self) -> bool {
        self.0.is_complete()
    }

    /// Add the next packet.
    ///
    /// Parameters
    /// ----------
    /// number : int
    /// data : bytes
    ///     56 bytes.
    ///
    /// Raises
    /// ------
    /// HidError
    ///     If a packet is missing or came twice.
    fn push(&mut self, number: u16, data: &[u8]) -> PyResult<()> {
        let data = data.try_into().map_err(|_| {
            HidError::new_err(format!("data has {} bytes; a packet of a calibration file has 56", data.len()))
        })?;
        self.0.push(&Packet { number, data }).map_err(raise)
    }

    /// The bytes received so far.
    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.0.bytes())
    }
}

/// A command to a blink(1) light.
#[pyclass(frozen, module = "gelstereo.hid")]
pub struct Blink1Command(Command);

fn led(number: i64) -> PyResult<Led> {
    match number {
        0 => Ok(Led::All),
        1 => Ok(Led::First),
        2 => Ok(Led::Second),
        _ => Err(HidError::new_err(format!("led is {number}; valid is 0 (all), 1 or 2"))),
    }
}

fn rgb(levels: [i64; 3]) -> PyResult<Rgb> {
    let valid = |level: i64| {
        u8::try_from(level).map_err(|_| {
            HidError::new_err(format!("color is {levels:?}; valid is three numbers from 0 to 255"))
        })
    };
    Ok(Rgb { red: valid(levels[0])?, green: valid(levels[1])?, blue: valid(levels[2])? })
}

#[pymethods]
impl Blink1Command {
    /// USB vendor of ThingM.
    #[classattr]
    const VENDOR: u16 = blink1::VENDOR;
    /// USB product of the blink(1).
    #[classattr]
    const PRODUCT: u16 = blink1::PRODUCT;

    /// Fade to a colour (red, green, blue; 0 to 255 each) within a time, milliseconds (0 to 655350).
    /// ``led`` is 0 for all lights, 1 or 2.
    #[staticmethod]
    #[pyo3(signature = (color, fade_ms, led=0))]
    fn fade(color: [i64; 3], fade_ms: i64, led: i64) -> PyResult<Self> {
        let color = rgb(color)?;
        let Ok(fade_ms) = u32::try_from(fade_ms) else {
            return Err(HidError::new_err(format!(
                "fade_ms is {fade_ms}; valid is 0 to {}",
                blink1::MAX_FADE_MS
            )));
        };
        Ok(Self(Command::Fade { color, fade_ms, led: self::led(led)? }))
    }

    /// Change to a colour (red, green, blue; 0 to 255 each) at once.
    #[staticmethod]
    #[pyo3(signature = (color, led=0))]
    fn set(color: [i64; 3], led: i64) -> PyResult<Self> {
        Ok(Self(Command::Set { color: rgb(color)?, led: self::led(led)? }))
    }

    /// Read the colour of a light; `decode_color` decodes the answer.
    #[staticmethod]
    #[pyo3(signature = (led=0))]
    fn read(led: i64) -> PyResult<Self> {
        Ok(Self(Command::Read { led: self::led(led)? }))
    }

    /// Read the firmware version; `decode_version` decodes the answer.
    #[staticmethod]
    fn version() -> Self {
        Self(Command::Version)
    }

    /// The feature report to send: 9 bytes, starting with the report number 1.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.0.encode().map_err(raise)?))
    }

    /// Decode the feature report fetched after ``read`` was sent.
    ///
    /// Returns
    /// -------
    /// (int, int, int)
    ///     Red, green, blue.
    ///
    /// Raises
    /// ------
    /// HidError
    ///     If the report answers another command.
    #[staticmethod]
    fn decode_color(report: &[u8]) -> PyResult<(u8, u8, u8)> {
        let Rgb { red, green, blue } = Rgb::decode(report).map_err(raise)?;
        Ok((red, green, blue))
    }

    /// Decode the feature report fetched after ``version`` was sent.
    ///
    /// Returns
    /// -------
    /// (int, int)
    ///     Major and minor version.
    ///
    /// Raises
    /// ------
    /// HidError
    ///     If the report answers another command.
    #[staticmethod]
    fn decode_version(report: &[u8]) -> PyResult<(u8, u8)> {
        let Version { major, minor } = Version::decode(report).map_err(raise)?;
        Ok((major, minor))
    }
}

/// The udev rule that lets the group plugdev and the user logged in at the computer open a product's HID
/// nodes.
#[pyfunction]
pub fn hid_udev_rule(vendor: u16, product: u16) -> String {
    gelstereo_host::hid::udev_rule(vendor, product)
}
