//! Messages of a recording. ROS uses metres: every length is divided by 1000, except where a field's name
//! ends in `_mm`.

use super::cdr::{CdrError, Decoder, Encoder};
use crate::gripper::GripperStatus;
use crate::source::Gray;
use gelstereo_core::force::Wrench;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::pipeline::Frame;

/// The sensor frame; "optical" is ROS's term for x right, y down, z away from the camera (REP 103).
pub const SENSOR_FRAME: &str = "gelstereo_left_optical_frame";
/// The right camera's frame.
pub const RIGHT_FRAME: &str = "gelstereo_right_optical_frame";
/// The robot's base.
pub const BASE_FRAME: &str = "base_link";

const METRES_PER_MM: f64 = 1e-3;
const NANOSECONDS: u64 = 1_000_000_000;
const FLOAT32: u8 = 7;
const UINT8: u8 = 2;

fn header(time_ns: u64, frame_id: &str) -> Encoder {
    let (seconds, nanoseconds) = (time_ns / NANOSECONDS, time_ns % NANOSECONDS);
    Encoder::default().i32(seconds as i32).u32(nanoseconds as u32).string(frame_id)
}

/// `std_msgs/msg/String`.
#[must_use]
pub fn string(text: &str) -> Vec<u8> {
    Encoder::default().string(text).finish()
}

/// Text of a `std_msgs/msg/String`.
///
/// # Errors
/// [`CdrError`].
pub fn read_string(bytes: &[u8]) -> Result<&str, CdrError> {
    Decoder::new(bytes)?.string()
}

/// `sensor_msgs/msg/Image`, mono8.
#[must_use]
pub fn image(time_ns: u64, frame_id: &str, image: &Gray) -> Vec<u8> {
    header(time_ns, frame_id)
        .u32(image.height as u32)
        .u32(image.width as u32)
        .string("mono8")
        .u8(0)
        .u32(image.width as u32)
        .byte_sequence(&image.pixels)
        .finish()
}

/// Time and pixels of a mono8 `sensor_msgs/msg/Image` without padding.
///
/// # Errors
/// [`CdrError`].
pub fn read_image(bytes: &[u8], image: &mut Gray) -> Result<u64, CdrError> {
    let mut decoder = Decoder::new(bytes)?;
    let (seconds, nanoseconds) = (decoder.u32()?, decoder.u32()?);
    decoder.string()?;
    (image.height, image.width) = (decoder.u32()? as usize, decoder.u32()? as usize);
    decoder.string()?;
    decoder.u8()?;
    decoder.u32()?;
    image.pixels.clear();
    image.pixels.extend_from_slice(decoder.byte_sequence()?);
    Ok(u64::from(seconds) * NANOSECONDS + u64::from(nanoseconds))
}

/// `sensor_msgs/msg/CompressedImage`; `format` is `png` or `jpeg`.
#[must_use]
pub fn compressed_image(time_ns: u64, frame_id: &str, format: &str, file: &[u8]) -> Vec<u8> {
    header(time_ns, frame_id).string(format).byte_sequence(file).finish()
}

/// Time, format and file of a `sensor_msgs/msg/CompressedImage`.
///
/// # Errors
/// [`CdrError`].
pub fn read_compressed_image(bytes: &[u8]) -> Result<CompressedImage<'_>, CdrError> {
    let mut decoder = Decoder::new(bytes)?;
    let (seconds, nanoseconds) = (decoder.u32()?, decoder.u32()?);
    decoder.string()?;
    let time_ns = u64::from(seconds) * NANOSECONDS + u64::from(nanoseconds);
    Ok(CompressedImage { time_ns, format: decoder.string()?, file: decoder.byte_sequence()? })
}

/// An image file in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompressedImage<'a> {
    /// Time stamp.
    pub time_ns: u64,
    /// `png` or `jpeg`.
    pub format: &'a str,
    /// Content of the file.
    pub file: &'a [u8],
}

/// `sensor_msgs/msg/PointCloud2` of all markers, `row * cols + col`: x y z in metres, indentation_mm in
/// millimetres, state (0 seen, 1 held, 2 lost) and salient (0, 1).
#[must_use]
pub fn points(time_ns: u64, frame: &Frame) -> Vec<u8> {
    const STEP: usize = 20; // four floats, two bytes, padding to a multiple of 4
    let fields = [("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("indentation_mm", 12, FLOAT32)];
    let flags = [("state", 16, UINT8), ("salient", 17, UINT8)];
    let mut data = Vec::with_capacity(frame.points_mm.len() * STEP);
    for (i, point_mm) in frame.points_mm.iter().enumerate() {
        let metres = *point_mm * METRES_PER_MM;
        for value in [metres.x, metres.y, metres.z, frame.indentation_mm[i]] {
            data.extend_from_slice(&(value as f32).to_le_bytes());
        }
        data.extend_from_slice(&[frame.state[i] as u8, u8::from(frame.salient[i]), 0, 0]);
    }
    let width = frame.cols.max(1);
    let height = frame.points_mm.len() / width;
    let encoder = header(time_ns, SENSOR_FRAME).u32(height as u32).u32(width as u32);
    let encoder = encoder.u32((fields.len() + flags.len()) as u32);
    let encoder = fields.iter().chain(&flags).fold(encoder, |encoder, &(name, offset, datatype)| {
        encoder.string(name).u32(offset).u8(datatype).u32(1)
    });
    encoder
        .u8(0)
        .u32(STEP as u32)
        .u32((STEP * width) as u32)
        .byte_sequence(&data)
        .u8(1) // is_dense: the pipeline gives no NaN
        .finish()
}

fn pose_fields(encoder: Encoder, pose: &Pose) -> Encoder {
    let position = pose.translation_mm * METRES_PER_MM;
    encoder.f64s(&position.to_array()).f64s(&pose.rotation.to_array())
}

/// `geometry_msgs/msg/PoseStamped`.
#[must_use]
pub fn pose(time_ns: u64, frame_id: &str, pose: &Pose) -> Vec<u8> {
    pose_fields(header(time_ns, frame_id), pose).finish()
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped` in the sensor frame; `covariance` in ROS order (x y z,
/// rotations about x y z), metres and radians.
#[must_use]
pub fn pose_with_covariance(time_ns: u64, pose: &Pose, covariance: &[[f64; 6]; 6]) -> Vec<u8> {
    let encoder = pose_fields(header(time_ns, SENSOR_FRAME), pose);
    covariance.iter().fold(encoder, |encoder, row| encoder.f64s(row)).finish()
}

/// `geometry_msgs/msg/WrenchStamped` in the sensor frame: newtons, and newton metres about the frame's
/// origin.
#[must_use]
pub fn wrench(time_ns: u64, wrench: &Wrench) -> Vec<u8> {
    let Wrench { force_n, torque_nmm, .. } = wrench.about(DVec3::ZERO);
    let torque_nm = torque_nmm * METRES_PER_MM;
    header(time_ns, SENSOR_FRAME).f64s(&force_n.to_array()).f64s(&torque_nm.to_array()).finish()
}

/// `sensor_msgs/msg/JointState` of the gripper: opening width in metres, and effort 1 while it holds an
/// object.
#[must_use]
pub fn joint_state(time_ns: u64, status: &GripperStatus) -> Vec<u8> {
    header(time_ns, "gripper")
        .u32(1)
        .string("width")
        .f64_sequence(&[status.width_mm * METRES_PER_MM])
        .f64_sequence(&[])
        .f64_sequence(&[f64::from(u8::from(status.object_detected))])
        .finish()
}
