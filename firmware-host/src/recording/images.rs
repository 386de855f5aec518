//! Encodes the images of a pair as messages.

use super::Topic;
use super::messages::{RIGHT_FRAME, SENSOR_FRAME, compressed_image, image};
use crate::config::ImageFormat;
use crate::source::{Encoded, Gray, StereoPair};
use gelstereo_png::PngEncoder;

/// Images queued for a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PairImages {
    /// Plain pixels, still to be encoded.
    Plain { left: Gray, right: Gray },
    /// As the camera sent them.
    Encoded(Encoded),
}

impl PairImages {
    /// Copies the images, because the pair's buffers belong to the frame source.
    pub fn of(pair: &StereoPair) -> Self {
        match &pair.encoded {
            Encoded::None => Self::Plain { left: pair.left.clone(), right: pair.right.clone() },
            encoded => Self::Encoded(encoded.clone()),
        }
    }

    /// Size in memory, bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Plain { left, right } => left.pixels.len() + right.pixels.len(),
            Self::Encoded(Encoded::None) => 0,
            Self::Encoded(Encoded::Joint { jpeg, .. }) => jpeg.len(),
            Self::Encoded(Encoded::Separate { left_jpeg, right_jpeg }) => left_jpeg.len() + right_jpeg.len(),
        }
    }
}

/// Encodes images as messages.
#[derive(Clone, Debug)]
pub(super) struct ImageEncoder {
    format: ImageFormat,
    png: PngEncoder,
    file: Vec<u8>,
}

impl ImageEncoder {
    pub fn new(format: ImageFormat) -> Self {
        Self { format, png: PngEncoder::default(), file: Vec::new() }
    }

    /// The topics and messages of one pair.
    pub fn messages(&mut self, time_ns: u64, images: &PairImages) -> Vec<(Topic, Vec<u8>)> {
        let jpeg = |frame_id, jpeg: &[u8]| compressed_image(time_ns, frame_id, "jpeg", jpeg);
        match images {
            PairImages::Plain { left, right } => match self.format {
                ImageFormat::Raw => vec![
                    (Topic::LeftImage, image(time_ns, SENSOR_FRAME, left)),
                    (Topic::RightImage, image(time_ns, RIGHT_FRAME, right)),
                ],
                ImageFormat::Png => vec![
                    (Topic::LeftCompressed, self.png(time_ns, SENSOR_FRAME, left)),
                    (Topic::RightCompressed, self.png(time_ns, RIGHT_FRAME, right)),
                ],
            },
            PairImages::Encoded(Encoded::None) => Vec::new(),
            PairImages::Encoded(Encoded::Joint { jpeg: joint, .. }) => {
                vec![(Topic::StereoCompressed, jpeg(SENSOR_FRAME, joint))]
            }
            PairImages::Encoded(Encoded::Separate { left_jpeg, right_jpeg }) => vec![
                (Topic::LeftCompressed, jpeg(SENSOR_FRAME, left_jpeg)),
                (Topic::RightCompressed, jpeg(RIGHT_FRAME, right_jpeg)),
            ],
        }
    }

    fn png(&mut self, time_ns: u64, frame_id: &str, gray: &Gray) -> Vec<u8> {
        self.file.clear();
        self.png.encode(&gray.pixels, gray.width, &mut self.file);
        compressed_image(time_ns, frame_id, "png", &self.file)
    }
}
