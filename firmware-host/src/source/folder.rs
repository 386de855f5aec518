//! Image pairs in a folder.

use super::{Capture, FrameSource, Gray, Next, SourceError, StereoPair};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

const NANOSECONDS_PER_SECOND: f64 = 1e9;

/// PNG, PGM and JPEG files whose names hold `left` or `right`, paired by the rest of the name, in its order.
///
/// Either all in one folder (`left_0001.png`, `right_0001.png`) or in its subfolders `left` and `right`. Colour is
/// turned into grey. The time of pair i is i / frame rate.
#[derive(Clone, Debug)]
pub struct FolderSource {
    pairs: Vec<(PathBuf, PathBuf)>,
    next: usize,
    period_ns: f64,
    size: Option<(usize, usize)>,
}

impl FolderSource {
    /// Lists and pairs the images; none is read yet.
    ///
    /// # Errors
    /// [`SourceError`] when the folder cannot be listed or an image has no partner.
    pub fn open(folder: &Path, frame_rate_hz: f64) -> Result<Self, SourceError> {
        let mut views: [BTreeMap<String, PathBuf>; 2] = Default::default();
        let mut images = 0;
        for path in image_files(folder)? {
            images += 1;
            let relative = path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().to_lowercase();
            let key = Path::new(&relative).with_extension("").to_string_lossy().into_owned();
            let (view, word) = match (key.contains("left"), key.contains("right")) {
                (true, false) => (0, "left"),
                (false, true) => (1, "right"),
                _ => continue,
            };
            if let Some(first) = views[view].insert(key.replace(word, ""), path.clone()) {
                return Err(SourceError::Ambiguous { first, second: path });
            }
        }
        let [lefts, mut rights] = views;
        let mut pairs = Vec::with_capacity(lefts.len());
        for (key, left) in lefts {
            let Some(right) = rights.remove(&key) else {
                return Err(SourceError::NoPartner { path: left, missing: "right" });
            };
            pairs.push((left, right));
        }
        if let Some(path) = rights.into_values().next() {
            return Err(SourceError::NoPartner { path, missing: "left" });
        }
        if pairs.is_empty() {
            return Err(SourceError::NoPairs { folder: folder.to_owned(), images });
        }
        Ok(Self { pairs, next: 0, period_ns: NANOSECONDS_PER_SECOND / frame_rate_hz, size: None })
    }

    fn read(&mut self, path: &Path, gray: &mut Gray) -> Result<(), SourceError> {
        let image = image::open(path)
            .map_err(|error| SourceError::Decode { path: path.to_owned(), message: error.to_string() })?
            .into_luma8();
        let found = (image.width() as usize, image.height() as usize);
        let expected = *self.size.get_or_insert(found);
        if found != expected {
            return Err(SourceError::SizeChange { path: path.to_owned(), found, expected });
        }
        *gray = Gray { width: found.0, height: found.1, pixels: image.into_raw() };
        Ok(())
    }
}

impl FrameSource for FolderSource {
    fn next_pair(&mut self, _timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        let Some((left, right)) = self.pairs.get(self.next).cloned() else {
            return Ok(Next::End);
        };
        self.read(&left, &mut pair.left)?;
        self.read(&right, &mut pair.right)?;
        pair.time_ns = (self.next as f64 * self.period_ns) as u64;
        pair.capture = Capture { sequence: self.next as u64, ..Capture::default() };
        self.next += 1;
        Ok(Next::Pair)
    }

    fn len_hint(&self) -> Option<usize> {
        Some(self.pairs.len())
    }
}

/// Image files of the folder and its direct subfolders, sorted.
fn image_files(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let list = |folder: &Path| -> Result<Vec<PathBuf>, SourceError> {
        let io = |error| SourceError::Io { path: folder.to_owned(), error };
        std::fs::read_dir(folder)
            .map_err(io)?
            .map(|entry| entry.map(|entry| entry.path()).map_err(io))
            .collect()
    };
    let mut files = Vec::new();
    for path in list(folder)? {
        if path.is_dir() {
            files.extend(list(&path)?);
        } else {
            files.push(path);
        }
    }
    files.retain(|path| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        matches!(extension.as_deref(), Some("png" | "pgm" | "jpg" | "jpeg"))
    });
    files.sort();
    Ok(files)
}
