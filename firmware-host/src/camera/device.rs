//! An opened video node: its capabilities, offers and format.

use super::abi::{
    self, BUF_TYPE_VIDEO_CAPTURE, Call, Capability, FIELD_ANY, FIELD_NONE, Format, FormatDescription,
    Fraction, FrameInterval, FrameSize, Plain, StreamParameters, TYPE_DISCRETE,
};
use super::{CameraConfig, CaptureError, FrameShape, NodeKind};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Relative tolerance of a driver's rate: 29.97 Hz passes for 30 Hz.
const RATE_TOLERANCE: f64 = 0.01;

/// Largest number of formats, sizes and rates listed in an error.
const MAX_OFFERS: usize = 60;

/// An opened video node.
#[derive(Debug)]
pub(super) struct Device {
    file: File,
    /// Path and description.
    pub name: String,
}

impl Device {
    /// Opens a node that delivers frames in one plane. Non-blocking: no call waits for a frame.
    pub fn open(path: &Path, name: &str) -> Result<Self, CaptureError> {
        let fail = |error| CaptureError::Open { path: path.to_owned(), error };
        let file = open_file(path).map_err(fail)?;
        let refuse = |what| Err(CaptureError::NotCapture { path: path.to_owned(), what });
        match kind_of(&file) {
            Ok(NodeKind::Capture) => Ok(Self { file, name: name.to_owned() }),
            Ok(NodeKind::Multiplanar) => refuse(
                "a multiplanar camera interface, which is not supported; libcamera or GStreamer can send its \
                        frames to standard input (source kind \"stream\")",
            ),
            Ok(NodeKind::Metadata) => refuse(
                "a metadata node; the frames are in another node of the same camera, usually the one before",
            ),
            Ok(NodeKind::Other | NodeKind::Unknown) => {
                refuse("a video node that frames cannot be streamed from")
            }
            Err(error) if error.raw_os_error() == Some(libc::ENOTTY) => refuse("no video node"),
            Err(error) => Err(fail(error)),
        }
    }

    pub fn call<T: Plain>(&self, call: &Call<T>, argument: &mut T) -> io::Result<()> {
        abi::call(self.file.as_fd(), call, argument)
    }

    /// As [`Self::call`], with an error that names device and call.
    pub fn must<T: Plain>(&self, call: &Call<T>, argument: &mut T) -> Result<(), CaptureError> {
        self.call(call, argument).map_err(|error| self.failed(call.name, error))
    }

    pub fn failed(&self, call: &'static str, error: io::Error) -> CaptureError {
        CaptureError::Call { device: self.name.clone(), call, error }
    }

    /// Sets format and size, and checks that the driver accepted them.
    pub fn set_format(&self, config: &CameraConfig) -> Result<FrameShape, CaptureError> {
        let offered = self.fourccs();
        let known = config.format.fourccs();
        let fourcc = *known.iter().find(|fourcc| offered.contains(fourcc)).unwrap_or(&known[0]);
        let [width, height] = config.size_px;
        let mut format = Format { buf_type: BUF_TYPE_VIDEO_CAPTURE, ..Format::zeroed() };
        let pix = &mut format.fmt.pix;
        (pix.width, pix.height, pix.pixelformat, pix.field) =
            (width, height, u32::from_le_bytes(fourcc), FIELD_NONE);
        self.must(&abi::S_FMT, &mut format)?;
        let pix = format.fmt.pix;
        let found_fourcc = pix.pixelformat.to_le_bytes();
        let wrong = |found: String| CaptureError::Format {
            device: self.name.clone(),
            asked: format!("{} {width}x{height}", text(fourcc)),
            found,
            offered: self.offers(),
        };
        if found_fourcc != fourcc || (pix.width, pix.height) != (width, height) {
            return Err(wrong(format!("{} {}x{}", text(found_fourcc), pix.width, pix.height)));
        }
        if !matches!(pix.field, FIELD_NONE | FIELD_ANY) {
            return Err(wrong("interlaced frames".to_owned()));
        }
        let (width, height) = (pix.width as usize, pix.height as usize);
        let row_bytes = config.format.row_bytes(width).unwrap_or(0);
        // 0 means that the driver does not pad.
        let stride = if pix.bytesperline == 0 { row_bytes } else { pix.bytesperline as usize };
        if stride < row_bytes {
            return Err(wrong(format!("rows of {stride} bytes where {row_bytes} are needed")));
        }
        Ok(FrameShape { format: config.format, width, height, stride })
    }

    /// Sets the frame rate and returns the driver's; `None` if the driver does not control it.
    pub fn set_rate(&self, config: &CameraConfig) -> Result<Option<f64>, CaptureError> {
        let asked_hz = config.frame_rate_hz;
        let mut parameters = StreamParameters {
            buf_type: BUF_TYPE_VIDEO_CAPTURE,
            time_per_frame: interval(asked_hz),
            ..StreamParameters::zeroed()
        };
        match self.call(&abi::S_PARM, &mut parameters) {
            Ok(()) => {}
            Err(error) if matches!(error.raw_os_error(), Some(libc::ENOTTY | libc::EINVAL)) => {
                return Ok(None);
            }
            Err(error) => return Err(self.failed(abi::S_PARM.name, error)),
        }
        if parameters.capability & abi::CAP_TIMEPERFRAME == 0 {
            return Ok(None);
        }
        let found_hz = rate_hz(parameters.time_per_frame);
        if (found_hz - asked_hz).abs() > RATE_TOLERANCE * asked_hz {
            let [width, height] = config.size_px;
            return Err(CaptureError::Format {
                device: self.name.clone(),
                asked: format!("{} {width}x{height} at {asked_hz} Hz", config.format),
                found: format!("{} Hz", hz(found_hz)),
                offered: self.offers(),
            });
        }
        Ok(Some(found_hz))
    }

    fn fourccs(&self) -> Vec<[u8; 4]> {
        self.enumerate(&abi::ENUM_FMT, |index| FormatDescription {
            index,
            buf_type: BUF_TYPE_VIDEO_CAPTURE,
            ..FormatDescription::zeroed()
        })
        .map(|description| description.pixelformat.to_le_bytes())
        .collect()
    }

    /// Formats, sizes and rates in words: `MJPG 1280x480 at 30, 15 Hz`.
    pub fn offers(&self) -> Vec<String> {
        let mut offers = Vec::new();
        for fourcc in self.fourccs() {
            let pixel_format = u32::from_le_bytes(fourcc);
            let before = offers.len();
            let sizes = self.enumerate(&abi::ENUM_FRAMESIZES, |index| FrameSize {
                index,
                pixel_format,
                ..FrameSize::zeroed()
            });
            for size in sizes {
                offers.push(format!("{} {}", text(fourcc), self.size_words(&size)));
            }
            if offers.len() == before {
                offers.push(text(fourcc));
            }
        }
        offers.truncate(MAX_OFFERS);
        offers
    }

    fn size_words(&self, size: &FrameSize) -> String {
        let [width, height, ..] = size.values;
        if size.kind != TYPE_DISCRETE {
            let [min_width, max_width, step_width, min_height, max_height, step_height] = size.values;
            return format!(
                "{min_width}x{min_height} to {max_width}x{max_height} in steps of {step_width}x{step_height}"
            );
        }
        let intervals = self.enumerate(&abi::ENUM_FRAMEINTERVALS, |index| FrameInterval {
            index,
            pixel_format: size.pixel_format,
            width,
            height,
            ..FrameInterval::zeroed()
        });
        let rates: Vec<String> = intervals
            .map(|interval| {
                let [first, second, _] = interval.values.map(rate_hz);
                if interval.kind == TYPE_DISCRETE {
                    hz(first).to_string()
                } else {
                    format!("{} to {}", hz(second), hz(first))
                }
            })
            .collect();
        if rates.is_empty() {
            format!("{width}x{height}")
        } else {
            format!("{width}x{height} at {} Hz", rates.join(", "))
        }
    }

    /// Repeats a call with the indices 0, 1, .. until the driver refuses one.
    fn enumerate<'a, T: Plain + 'a>(
        &'a self,
        call: &'a Call<T>,
        ask: impl Fn(u32) -> T + 'a,
    ) -> impl Iterator<Item = T> + 'a {
        // Bounded in case a driver never refuses.
        (0..256).map_while(move |index| {
            let mut answer = ask(index);
            self.call(call, &mut answer).ok().map(|()| answer)
        })
    }
}

impl AsFd for Device {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

/// Kind of a node.
pub(super) fn kind(path: &Path) -> io::Result<NodeKind> {
    kind_of(&open_file(path)?)
}

fn open_file(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY).open(path)
}

fn kind_of(file: &File) -> io::Result<NodeKind> {
    let mut capability = Capability::zeroed();
    abi::call(file.as_fd(), &abi::QUERYCAP, &mut capability)?;
    // `device_caps` belongs to this node, `capabilities` to all nodes of the device.
    let of_node = capability.capabilities & abi::CAP_DEVICE_CAPS != 0;
    let caps = if of_node { capability.device_caps } else { capability.capabilities };
    let has = |bit: u32| caps & bit != 0;
    Ok(if has(abi::CAP_META_CAPTURE) {
        NodeKind::Metadata
    } else if has(abi::CAP_VIDEO_CAPTURE) && has(abi::CAP_STREAMING) {
        NodeKind::Capture
    } else if has(abi::CAP_VIDEO_CAPTURE_MPLANE) {
        NodeKind::Multiplanar
    } else {
        NodeKind::Other
    })
}

/// Frame interval of a rate, exact for whole rates.
fn interval(rate_hz: f64) -> Fraction {
    if rate_hz.fract() == 0.0 {
        Fraction { numerator: 1, denominator: rate_hz as u32 }
    } else {
        Fraction { numerator: 1000, denominator: (rate_hz * 1000.0).round() as u32 }
    }
}

fn rate_hz(interval: Fraction) -> f64 {
    f64::from(interval.denominator) / f64::from(interval.numerator)
}

/// Rounds a rate to two decimal places.
fn hz(rate: f64) -> f64 {
    (rate * 100.0).round() / 100.0
}

fn text(fourcc: [u8; 4]) -> String {
    String::from_utf8_lossy(&fourcc).trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn files_that_are_no_video_nodes_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("video0");
        std::fs::write(&file, "").unwrap();
        let error = Device::open(&file, "x").unwrap_err().to_string();
        assert!(error.ends_with("video0 is no video node"), "{error}");
        let null = Device::open(Path::new("/dev/null"), "x").unwrap_err().to_string();
        assert_eq!(null, "/dev/null is no video node");
        let none = Device::open(&folder.path().join("none"), "x").unwrap_err().to_string();
        assert!(none.contains("cannot open"), "{none}");
    }

    #[test]
    fn intervals_are_exact() {
        for rate in [30.0, 15.0, 7.5, 29.97, 120.0] {
            assert!((rate_hz(interval(rate)) - rate).abs() < 1e-9, "{rate}");
        }
    }
}
