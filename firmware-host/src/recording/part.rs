//! One MCAP file of a recording.
//!
//! A chunk is built in memory and appended whole; the file never contains a placeholder to be filled in
//! later. A process that ends at any point thus leaves complete chunks, followed at worst by a partial one.

use super::store::Store;
use super::{METADATA, RecordingError, Topic};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Largest chunk, held in memory; beyond this size it is closed before its time is over.
const MAX_CHUNK_BYTES: u64 = 4 << 20;

/// A message queued for a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Message {
    pub topic: Topic,
    /// Time of recording.
    pub log_ns: u64,
    /// Time that the message refers to.
    pub publish_ns: u64,
    pub data: Vec<u8>,
    /// Whether it is the first message of a pair.
    pub begins_pair: bool,
}

/// Content at the start of every file of a recording.
#[derive(Clone, Debug, Default)]
pub(super) struct Preamble {
    pub metadata: BTreeMap<String, String>,
    pub attachments: Vec<(String, Vec<u8>)>,
}

/// Appends to a store, counts bytes, and optionally syncs on flush.
struct Appender {
    store: BufWriter<Box<dyn Store>>,
    bytes: Arc<AtomicU64>,
    durable: bool,
}

impl Write for Appender {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.store.write(bytes)?;
        self.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.store.flush()?;
        if self.durable { self.store.get_mut().sync() } else { Ok(()) }
    }
}

/// One open file.
pub(super) struct PartFile {
    writer: mcap::Writer<NoSeek<Appender>>,
    channels: [Option<u16>; Topic::ALL.len()],
    sequences: [u32; Topic::ALL.len()],
    bytes: Arc<AtomicU64>,
    pending: u64,
}

impl PartFile {
    /// Writes the start of the file. With `durable` each flush waits for the disk.
    pub fn begin(store: Box<dyn Store>, preamble: &Preamble, durable: bool) -> Result<Self, RecordingError> {
        let bytes = Arc::new(AtomicU64::new(0));
        let appender = Appender { store: BufWriter::new(store), bytes: Arc::clone(&bytes), durable };
        let mut writer = mcap::WriteOptions::new()
            // Compression saves little with compressed images, but its frames let readers detect damage:
            // in a damaged uncompressed chunk, crate mcap 0.26 underflows a counter.
            .compression(Some(mcap::Compression::Lz4))
            .chunk_size(Some(MAX_CHUNK_BYTES))
            // Makes the writer build a chunk in memory and append it whole.
            .disable_seeking(true)
            .profile("ros2")
            .library(concat!("gelstereo-host ", env!("CARGO_PKG_VERSION")))
            .create(NoSeek::new(appender))
            .map_err(RecordingError::writing)?;
        let metadata = Metadata { name: METADATA.to_owned(), metadata: preamble.metadata.clone() };
        writer.write_metadata(&metadata).map_err(RecordingError::writing)?;
        for (name, data) in &preamble.attachments {
            let attachment = mcap::Attachment {
                log_time: 0,
                create_time: 0,
                name: name.clone(),
                media_type: "application/octet-stream".to_owned(),
                data: Cow::Borrowed(data),
            };
            writer.attach(&attachment).map_err(RecordingError::writing)?;
        }
        writer.flush().map_err(RecordingError::writing)?;
        let channels = [None; Topic::ALL.len()];
        Ok(Self { writer, channels, sequences: [0; Topic::ALL.len()], bytes, pending: 0 })
    }

    /// Adds a message to the open chunk.
    pub fn write(&mut self, message: &Message) -> Result<(), RecordingError> {
        let index = message.topic as usize;
        let channel_id = match self.channels[index] {
            Some(channel_id) => channel_id,
            None => self.add_channel(message.topic)?,
        };
        let header = MessageHeader {
            channel_id,
            sequence: self.sequences[index],
            log_time: message.log_ns,
            publish_time: message.publish_ns,
        };
        self.sequences[index] = self.sequences[index].wrapping_add(1);
        self.pending += message.data.len() as u64;
        self.writer.write_to_known_channel(&header, &message.data).map_err(RecordingError::writing)
    }

    fn add_channel(&mut self, topic: Topic) -> Result<u16, RecordingError> {
        let schema = topic.schema();
        let schema_id = self
            .writer
            .add_schema(schema.name, "ros2msg", schema.definition.as_bytes())
            .map_err(RecordingError::writing)?;
        let channel_id = self
            .writer
            .add_channel(schema_id, topic.name(), "cdr", &BTreeMap::new())
            .map_err(RecordingError::writing)?;
        self.channels[topic as usize] = Some(channel_id);
        Ok(channel_id)
    }

    /// Size of the file plus messages still in memory, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed) + self.pending
    }

    /// Closes the chunk and passes it to the operating system.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.pending = 0;
        self.writer.flush().map_err(RecordingError::writing)
    }

    /// Writes the index and closes the file. Returns its size in bytes.
    pub fn finish(mut self) -> Result<u64, RecordingError> {
        self.writer.finish().map_err(RecordingError::writing)?;
        let mut appender = self.writer.into_inner().into_inner();
        appender.flush().map_err(RecordingError::Disk)?;
        appender.store.get_mut().sync().map_err(RecordingError::Disk)?;
        Ok(self.bytes.load(Ordering::Relaxed))
    }
}
