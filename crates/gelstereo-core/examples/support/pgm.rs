//! Grey images from files.

use gelstereo_core::image::GrayView;
use std::error::Error;
use std::fs;

pub type Outcome<T> = Result<T, Box<dyn Error>>;

/// A binary grey image.
pub struct Pgm {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Pgm {
    /// Reads `P5 width height 255` and the pixels, as OpenCV writes them.
    pub fn read(path: &str) -> Outcome<Self> {
        let bytes = fs::read(path)?;
        let mut at = 0;
        let mut word = || {
            let start = at;
            while at < bytes.len() && !bytes[at].is_ascii_whitespace() {
                at += 1;
            }
            at += 1;
            String::from_utf8_lossy(bytes.get(start..at - 1).unwrap_or_default()).into_owned()
        };
        if word() != "P5" {
            return Err(format!("{path} is no binary PGM").into());
        }
        let (width, height) = (word().parse()?, word().parse()?);
        word();
        Ok(Self { width, height, pixels: bytes.get(at..).unwrap_or_default().to_vec() })
    }

    /// Borrows it.
    pub fn view(&self) -> Outcome<GrayView<'_>> {
        Ok(GrayView::new(&self.pixels, self.width, self.height, self.width)?)
    }
}
