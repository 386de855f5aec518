//! Storage for the files of a recording.

use super::RecordingError;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// An append-only target for one file of a recording.
pub trait Store: Write + Send {
    /// Returns when the data written so far would survive a power cut.
    ///
    /// # Errors
    /// The system's error.
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Store for File {
    fn sync(&mut self) -> io::Result<()> {
        match self.sync_data() {
            // Devices and pipes cannot be synced.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
            result => result,
        }
    }
}

/// Opens the file of part 0, 1 and so on, and returns its path.
pub type OpenPart = Box<dyn FnMut(u32) -> Result<(PathBuf, Box<dyn Store>), RecordingError> + Send>;

/// Creates files `run.mcap`, `run_0001.mcap` and so on.
pub(super) fn files(first: PathBuf) -> OpenPart {
    Box::new(move |part| {
        let path = part_path(&first, part);
        let file = File::create(&path).map_err(|error| RecordingError::Io {
            path: path.clone(),
            doing: "create",
            error,
        })?;
        Ok((path, Box::new(file)))
    })
}

/// The first part has the path itself; later ones are created beside it.
#[must_use]
pub fn part_path(first: &Path, part: u32) -> PathBuf {
    if part == 0 {
        return first.to_owned();
    }
    let stem = first.file_stem().unwrap_or_default().to_string_lossy();
    let extension = first.extension().unwrap_or_default().to_string_lossy();
    let dot = if extension.is_empty() { "" } else { "." };
    first.with_file_name(format!("{stem}_{part:04}{dot}{extension}"))
}

/// A recording in memory, for tests and for comparing runs. All parts are concatenated.
#[derive(Clone, Debug, Default)]
pub struct SharedBuffer(Arc<Mutex<Vec<u8>>>);

impl SharedBuffer {
    /// The bytes written so far.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Write for SharedBuffer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Store for SharedBuffer {}
