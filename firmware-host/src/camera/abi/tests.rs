//! Compares structures and numbers with the kernel's header.
#![allow(clippy::unwrap_used)]
use super::*;
use std::mem::{align_of, offset_of, size_of};
use std::process::Command;

/// Pairs of an expression in C and its value here.
fn expectations() -> Vec<(String, usize)> {
    let mut list: Vec<(String, usize)> =
        NUMBERS.iter().map(|(n, v)| ((*n).to_owned(), *v as usize)).collect();
    let mut add = |c: &str, value: usize| list.push((c.to_owned(), value));
    macro_rules! sizes {
        ($($rust:ty = $c:literal),+ $(,)?) => {
            $(add(concat!("sizeof(struct ", $c, ")"), size_of::<$rust>());
              add(concat!("_Alignof(struct ", $c, ")"), align_of::<$rust>());)+
        };
    }
    sizes! {
        Capability = "v4l2_capability", FormatDescription = "v4l2_fmtdesc", Format = "v4l2_format",
        PixFormat = "v4l2_pix_format", StreamParameters = "v4l2_streamparm",
        FrameSize = "v4l2_frmsizeenum", FrameInterval = "v4l2_frmivalenum",
        RequestBuffers = "v4l2_requestbuffers", Buffer = "v4l2_buffer",
        QueryExtCtrl = "v4l2_query_ext_ctrl", QueryMenu = "v4l2_querymenu", ExtControl = "v4l2_ext_control",
        ExtControls = "v4l2_ext_controls",
    }
    macro_rules! offsets {
        ($($rust:ty, $field:ident = $c:literal, $member:literal),+ $(,)?) => {
            $(add(concat!("offsetof(struct ", $c, ", ", $member, ")"), offset_of!($rust, $field));)+
        };
    }
    offsets! {
        Capability, device_caps = "v4l2_capability", "device_caps",
        FormatDescription, pixelformat = "v4l2_fmtdesc", "pixelformat",
        Format, fmt = "v4l2_format", "fmt",
        PixFormat, bytesperline = "v4l2_pix_format", "bytesperline",
        StreamParameters, time_per_frame = "v4l2_streamparm", "parm.capture.timeperframe",
        FrameSize, values = "v4l2_frmsizeenum", "discrete",
        FrameInterval, values = "v4l2_frmivalenum", "discrete",
        Buffer, timestamp = "v4l2_buffer", "timestamp", Buffer, sequence = "v4l2_buffer", "sequence",
        Buffer, offset = "v4l2_buffer", "m.offset", Buffer, length = "v4l2_buffer", "length",
        QueryExtCtrl, minimum = "v4l2_query_ext_ctrl", "minimum",
        QueryExtCtrl, flags = "v4l2_query_ext_ctrl", "flags",
        QueryMenu, name = "v4l2_querymenu", "name", ExtControl, value = "v4l2_ext_control", "value",
        ExtControls, controls = "v4l2_ext_controls", "controls",
    }
    for (c, value) in [
        ("V4L2_BUF_TYPE_VIDEO_CAPTURE", BUF_TYPE_VIDEO_CAPTURE),
        ("V4L2_MEMORY_MMAP", MEMORY_MMAP),
        ("V4L2_FIELD_ANY", FIELD_ANY),
        ("V4L2_FIELD_NONE", FIELD_NONE),
        ("V4L2_CAP_VIDEO_CAPTURE", CAP_VIDEO_CAPTURE),
        ("V4L2_CAP_VIDEO_CAPTURE_MPLANE", CAP_VIDEO_CAPTURE_MPLANE),
        ("V4L2_CAP_META_CAPTURE", CAP_META_CAPTURE),
        ("V4L2_CAP_STREAMING", CAP_STREAMING),
        ("V4L2_CAP_DEVICE_CAPS", CAP_DEVICE_CAPS),
        ("V4L2_CAP_TIMEPERFRAME", CAP_TIMEPERFRAME),
        ("V4L2_BUF_FLAG_ERROR", BUF_FLAG_ERROR),
        ("V4L2_BUF_FLAG_TIMESTAMP_MASK", BUF_FLAG_TIMESTAMP_MASK),
        ("V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC", BUF_FLAG_TIMESTAMP_MONOTONIC),
        ("V4L2_FRMSIZE_TYPE_DISCRETE", TYPE_DISCRETE),
        ("V4L2_FRMIVAL_TYPE_DISCRETE", TYPE_DISCRETE),
        ("V4L2_CTRL_FLAG_DISABLED", CTRL_FLAG_DISABLED),
        ("V4L2_CTRL_FLAG_READ_ONLY", CTRL_FLAG_READ_ONLY),
        ("V4L2_CTRL_FLAG_INACTIVE", CTRL_FLAG_INACTIVE),
        ("V4L2_CTRL_FLAG_WRITE_ONLY", CTRL_FLAG_WRITE_ONLY),
        ("V4L2_CTRL_FLAG_NEXT_CTRL", CTRL_FLAG_NEXT_CTRL),
    ] {
        add(c, value as usize);
    }
    list
}

/// Compiles against the kernel's header with the C compiler and compares the values.
#[test]
fn structures_and_numbers_are_the_kernel_headers() {
    let folder = tempfile::tempdir().unwrap();
    let (source, binary) = (folder.path().join("abi.c"), folder.path().join("abi"));
    let expected = expectations();
    let mut program = String::from(
        "#include <linux/videodev2.h>\n#include <stddef.h>\n#include <stdio.h>\nint main(void) {\n",
    );
    for (expression, _) in &expected {
        program += &format!("printf(\"%llu\\n\", (unsigned long long)({expression}));\n");
    }
    std::fs::write(&source, program + "return 0; }\n").unwrap();
    let Ok(built) = Command::new("cc").arg(&source).arg("-o").arg(&binary).output() else {
        eprintln!("skipped: there is no C compiler `cc` to read linux/videodev2.h with");
        return;
    };
    let message = String::from_utf8_lossy(&built.stderr);
    if message.contains("linux/videodev2.h: No such file") {
        eprintln!("skipped: there is no linux/videodev2.h");
        return;
    }
    assert!(built.status.success(), "{message}");
    let output = String::from_utf8(Command::new(&binary).output().unwrap().stdout).unwrap();
    let found: Vec<usize> = output.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(found.len(), expected.len());
    for ((expression, here), kernel) in expected.iter().zip(found) {
        assert_eq!(*here, kernel, "{expression}");
    }
}

#[test]
fn text_ends_at_the_first_zero() {
    assert_eq!(text(b"uvcvideo\0\0junk"), "uvcvideo");
    assert_eq!(text(b"full"), "full");
}
