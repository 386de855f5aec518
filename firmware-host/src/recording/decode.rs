//! Decodes the images of a pair from messages.

use super::{RecordingError, Topic, messages};
use crate::source::jpeg::JpegDecoder;
use crate::source::{Gray, StereoLayout, StereoPair};

/// Decodes image messages into a pair, with the same decoders as live camera images.
#[derive(Clone, Debug, Default)]
pub struct ImageDecoder {
    jpeg: JpegDecoder,
    joint: Gray,
}

impl ImageDecoder {
    /// Takes an image message; returns whether it completes the pair. `layout` is the position of the
    /// views in a combined image.
    ///
    /// # Errors
    /// [`RecordingError::Message`] or [`RecordingError::Content`] when it is not a valid image.
    pub fn take(
        &mut self,
        topic: Topic,
        data: &[u8],
        layout: StereoLayout,
        pair: &mut StereoPair,
    ) -> Result<bool, RecordingError> {
        let fail = |error| RecordingError::Message { topic: topic.name(), error };
        match topic {
            Topic::LeftImage => pair.time_ns = messages::read_image(data, &mut pair.left).map_err(fail)?,
            Topic::RightImage => {
                messages::read_image(data, &mut pair.right).map_err(fail)?;
                return Ok(true);
            }
            Topic::LeftCompressed => {
                let image = messages::read_compressed_image(data).map_err(fail)?;
                pair.time_ns = image.time_ns;
                self.file(topic, &image, &mut pair.left)?;
            }
            Topic::RightCompressed => {
                let image = messages::read_compressed_image(data).map_err(fail)?;
                self.file(topic, &image, &mut pair.right)?;
                return Ok(true);
            }
            Topic::StereoCompressed => {
                let image = messages::read_compressed_image(data).map_err(fail)?;
                pair.time_ns = image.time_ns;
                let mut joint = std::mem::take(&mut self.joint);
                self.file(topic, &image, &mut joint)?;
                let content = |error: String| RecordingError::Content { place: topic.name(), error };
                let view = joint.view().map_err(|error| content(error.to_string()))?;
                layout
                    .split(view, &mut pair.left, &mut pair.right)
                    .map_err(|error| content(error.to_string()))?;
                self.joint = joint;
                return Ok(true);
            }
            _ => {}
        }
        Ok(false)
    }

    fn file(
        &mut self,
        topic: Topic,
        image: &messages::CompressedImage<'_>,
        gray: &mut Gray,
    ) -> Result<(), RecordingError> {
        let fail = |error: String| RecordingError::Content { place: topic.name(), error };
        match image.format {
            "jpeg" => self.jpeg.decode(image.file, gray).map_err(|error| fail(error.to_string())),
            "png" => {
                let decoded = image::load_from_memory_with_format(image.file, image::ImageFormat::Png)
                    .map_err(|error| fail(error.to_string()))?
                    .into_luma8();
                *gray = Gray {
                    width: decoded.width() as usize,
                    height: decoded.height() as usize,
                    pixels: decoded.into_raw(),
                };
                Ok(())
            }
            format => Err(fail(format!("an image has the format {format:?}; valid is \"jpeg\" or \"png\""))),
        }
    }
}
