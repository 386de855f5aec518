//! Image pairs in a folder.

use super::{Capture, FrameSource, Gray, Next, SourceError, StereoPair, natural};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

const NANOSECONDS_PER_SECOND: f64 = 1e9;

/// PNG, PGM and JPEG files with `left` or `right` in their names, paired by the rest of the name in
/// natural order: numbers compare as numbers, so that `left_3` precedes `left_29`.
///
/// The images are either in one folder (`left_0001.png`, `right_0001.png`) or in its subfolders `left`
/// and `right`. Colour is converted to grey. Images that differ in leading zeros (`left_3.png`,
/// `right_03.png`) form a pair if no other image has that number. Missing numbers count as dropped pairs
/// ([`Capture::dropped`]). The time of pair i, counting missing ones, is i / frame rate.
#[derive(Clone, Debug)]
pub struct FolderSource {
    pairs: Vec<FolderPair>,
    next: usize,
    period_ns: f64,
    size: Option<(usize, usize)>,
}

/// Two files of one pair.
#[derive(Clone, Debug)]
struct FolderPair {
    left: PathBuf,
    right: PathBuf,
    /// Number of pairs before this one, including missing ones.
    sequence: u64,
    /// Number of missing pairs since the previous one.
    dropped: u64,
}

/// Images of one view, keyed by the rest of their names.
type View = BTreeMap<String, PathBuf>;

impl FolderSource {
    /// Lists and pairs the images without reading them.
    ///
    /// # Errors
    /// [`SourceError`] if the folder cannot be listed or an image has no partner.
    pub fn open(folder: &Path, frame_rate_hz: f64) -> Result<Self, SourceError> {
        let mut views: [View; 2] = Default::default();
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
        let matched = match_views(views)?;
        if matched.is_empty() {
            return Err(SourceError::NoPairs { folder: folder.to_owned(), images });
        }
        let pairs = numbered(matched);
        Ok(Self { pairs, next: 0, period_ns: NANOSECONDS_PER_SECOND / frame_rate_hz, size: None })
    }

    /// Number of pairs missing from the numbering of the files.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.pairs.iter().map(|pair| pair.dropped).sum()
    }

    /// Width and height of the first image, pixels; all images must match.
    ///
    /// # Errors
    /// [`SourceError::Decode`].
    pub fn size_px(&self) -> Result<(usize, usize), SourceError> {
        let path = &self.pairs[0].left;
        let wrong =
            |error: image::ImageError| SourceError::Decode { path: path.clone(), message: error.to_string() };
        let (width, height) = image::image_dimensions(path).map_err(wrong)?;
        Ok((width as usize, height as usize))
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
        let Some(FolderPair { left, right, sequence, dropped }) = self.pairs.get(self.next).cloned() else {
            return Ok(Next::End);
        };
        self.read(&left, &mut pair.left)?;
        self.read(&right, &mut pair.right)?;
        pair.time_ns = (sequence as f64 * self.period_ns) as u64;
        pair.capture = Capture { sequence, dropped, ..Capture::default() };
        pair.stale = false;
        self.next += 1;
        Ok(Next::Pair)
    }

    fn len_hint(&self) -> Option<usize> {
        Some(self.pairs.len())
    }
}

/// Left and right path, keyed by the rest of the left name: equal names first, the remaining ones by
/// equal numbers.
fn match_views([lefts, mut rights]: [View; 2]) -> Result<Vec<(String, PathBuf, PathBuf)>, SourceError> {
    let by_number = |view: &View| {
        let mut names: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
        for (name, path) in view {
            names.entry(natural::without_leading_zeros(name)).or_default().push(path.clone());
        }
        names
    };
    let numbers = [by_number(&lefts), by_number(&rights)];
    let (mut matched, mut unmatched) = (Vec::with_capacity(lefts.len()), Vec::new());
    for (name, left) in lefts {
        match rights.remove(&name) {
            Some(right) => matched.push((name, left, right)),
            None => unmatched.push((name, left)),
        }
    }
    for (name, left) in unmatched {
        let number = natural::without_leading_zeros(&name);
        let Some(right_name) =
            rights.keys().find(|right| natural::without_leading_zeros(right) == number).cloned()
        else {
            return Err(SourceError::NoPartner { path: left, missing: "right" });
        };
        for view in &numbers {
            if let Some([first, second, ..]) = view.get(&number).map(Vec::as_slice) {
                return Err(SourceError::Ambiguous { first: first.clone(), second: second.clone() });
            }
        }
        if let Some(right) = rights.remove(&right_name) {
            matched.push((name, left, right));
        }
    }
    match rights.into_values().next() {
        Some(path) => Err(SourceError::NoPartner { path, missing: "left" }),
        None => Ok(matched),
    }
}

/// Sorts pairs in natural order and adds the gaps of their numbering.
fn numbered(mut matched: Vec<(String, PathBuf, PathBuf)>) -> Vec<FolderPair> {
    matched.sort_by(|(a, ..), (b, ..)| natural::compare(a, b));
    let names: Vec<&str> = matched.iter().map(|(name, ..)| name.as_str()).collect();
    let gaps = natural::gaps(&names);
    let mut before = 0;
    let place = |((_, left, right), dropped): ((String, PathBuf, PathBuf), u64)| {
        let sequence = before + dropped;
        before = sequence + 1;
        FolderPair { left, right, sequence, dropped }
    };
    matched.into_iter().zip(gaps).map(place).collect()
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
