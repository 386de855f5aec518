//! Writing a recording.

use super::{METADATA, METADATA_CONFIG, METADATA_VERSION, RecordingError, Topic};
use mcap::records::{MessageHeader, Metadata};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Cursor, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Something that a recording can be written to.
pub trait Sink: Write + Seek {}
impl<W: Write + Seek> Sink for W {}

/// Writes one recording.
pub struct Recorder {
    writer: mcap::Writer<Box<dyn Sink>>,
    channels: [u16; Topic::ALL.len()],
    sequences: [u32; Topic::ALL.len()],
}

impl Recorder {
    /// Creates the file, and the folder that it stands in.
    ///
    /// # Errors
    /// [`RecordingError::Io`] when the file cannot be created.
    pub fn create(
        path: &Path,
        config_toml: &str,
        attachments: &[(String, Vec<u8>)],
    ) -> Result<Self, RecordingError> {
        let io = |doing| move |error| RecordingError::Io { path: path.to_owned(), doing, error };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(io("create the folder of"))?;
        }
        let file = File::create(path).map_err(io("create"))?;
        Self::new(Box::new(BufWriter::new(file)), config_toml, attachments)
    }

    /// Starts a recording: configuration and attachments come first, so that they survive any cut.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn new(
        sink: Box<dyn Sink>,
        config_toml: &str,
        attachments: &[(String, Vec<u8>)],
    ) -> Result<Self, RecordingError> {
        let mut writer = mcap::WriteOptions::new()
            .compression(Some(mcap::Compression::Lz4))
            .profile("ros2")
            .library(concat!("gelstereo-host ", env!("CARGO_PKG_VERSION")))
            .create(sink)
            .map_err(RecordingError::writing)?;
        let entries = [(METADATA_CONFIG, config_toml), (METADATA_VERSION, env!("CARGO_PKG_VERSION"))];
        let metadata = entries.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        writer
            .write_metadata(&Metadata { name: METADATA.to_owned(), metadata })
            .map_err(RecordingError::writing)?;
        for (name, data) in attachments {
            writer
                .attach(&mcap::Attachment {
                    log_time: 0,
                    create_time: 0,
                    name: name.clone(),
                    media_type: "application/octet-stream".to_owned(),
                    data: Cow::Borrowed(data),
                })
                .map_err(RecordingError::writing)?;
        }
        let mut channels = [0; Topic::ALL.len()];
        for (channel, topic) in channels.iter_mut().zip(Topic::ALL) {
            let schema = topic.schema();
            let schema_id = writer
                .add_schema(schema.name, "ros2msg", schema.definition.as_bytes())
                .map_err(RecordingError::writing)?;
            *channel = writer
                .add_channel(schema_id, topic.name(), "cdr", &BTreeMap::new())
                .map_err(RecordingError::writing)?;
        }
        Ok(Self { writer, channels, sequences: [0; Topic::ALL.len()] })
    }

    /// Writes one message.
    ///
    /// # Errors
    /// [`RecordingError::Disk`] with the system's answer.
    pub fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]) -> Result<(), RecordingError> {
        let index = topic as usize;
        let header = MessageHeader {
            channel_id: self.channels[index],
            sequence: self.sequences[index],
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.sequences[index] = self.sequences[index].wrapping_add(1);
        self.writer.write_to_known_channel(&header, message).map_err(RecordingError::writing)
    }

    /// Ends the chunk and hands everything to the operating system.
    ///
    /// # Errors
    /// [`RecordingError::Disk`] with the system's answer.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush().map_err(RecordingError::writing)
    }

    /// Writes the index and closes the recording.
    ///
    /// # Errors
    /// [`RecordingError::Disk`] with the system's answer.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish().map_err(RecordingError::writing)?;
        self.writer.into_inner().flush().map_err(RecordingError::Disk)
    }
}

/// A recording in memory, for tests and for comparing runs.
#[derive(Clone, Debug, Default)]
pub struct SharedBuffer(Arc<Mutex<Cursor<Vec<u8>>>>);

impl SharedBuffer {
    /// The bytes so far.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        self.lock().get_ref().clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Cursor<Vec<u8>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for SharedBuffer {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.lock().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Seek for SharedBuffer {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.lock().seek(to)
    }
}
