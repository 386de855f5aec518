//! Reads a recording sequentially in constant memory, up to a truncation.

use super::{METADATA, RecordingError, Topic};
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Longest record; longer ones are damage. One stereo pair is far below it.
const MAX_RECORD_BYTES: usize = 1 << 28;

/// One element of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// The metadata record [`METADATA`].
    Metadata(BTreeMap<String, String>),
    /// An attached file.
    Attachment {
        /// Its name.
        name: String,
        /// Its bytes.
        data: Vec<u8>,
    },
    /// A message on a known topic; others are skipped.
    Message {
        /// Its topic.
        topic: Topic,
        /// Time on the frame source's clock.
        time_ns: u64,
        /// CDR-encoded message.
        data: Vec<u8>,
    },
}

/// Reads a recording in the order of writing.
pub struct Reader {
    input: Box<dyn Read>,
    reader: LinearReader,
    topics: BTreeMap<u16, Topic>,
    truncated: bool,
}

impl Reader {
    /// Opens a file.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|error| RecordingError::Io {
            path: path.to_owned(),
            doing: "open",
            error,
        })?;
        Ok(Self::new(Box::new(BufReader::new(file))))
    }

    /// Reads from any input.
    #[must_use]
    pub fn new(input: Box<dyn Read>) -> Self {
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        let reader = LinearReader::new_with_options(options);
        Self { input, reader, topics: BTreeMap::new(), truncated: false }
    }

    /// Whether the file lacked its end mark; final once [`Self::next_item`] returned `None`.
    #[must_use]
    pub const fn truncated(&self) -> bool {
        self.truncated
    }

    /// The next item; `None` at the end or at a truncation, and on every later call.
    ///
    /// # Errors
    /// [`RecordingError::Format`] when the file is not MCAP or is damaged before its end.
    pub fn next_item(&mut self) -> Result<Option<Item>, RecordingError> {
        if self.truncated {
            return Ok(None);
        }
        let mut ended = false;
        loop {
            let event = match self.reader.next_event() {
                None => return Ok(None),
                Some(Err(McapError::UnexpectedEof | McapError::UnexpectedEoc)) if ended => {
                    self.truncated = true;
                    return Ok(None);
                }
                Some(event) => event?,
            };
            match event {
                LinearReadEvent::ReadRequest(_) if ended => {
                    self.truncated = true;
                    return Ok(None);
                }
                LinearReadEvent::ReadRequest(count) => {
                    let read = self.input.read(self.reader.insert(count)).map_err(RecordingError::Disk)?;
                    self.reader.notify_read(read);
                    ended = read == 0;
                }
                LinearReadEvent::Record { data, opcode } => {
                    let record = mcap::parse_record(opcode, data)?.into_owned();
                    if let Some(item) = self.item(record) {
                        return Ok(Some(item));
                    }
                }
            }
        }
    }

    fn item(&mut self, record: Record<'static>) -> Option<Item> {
        match record {
            Record::Channel(channel) => {
                if let Some(topic) = Topic::from_name(&channel.topic) {
                    self.topics.insert(channel.id, topic);
                }
                None
            }
            Record::Message { header, data } => {
                let topic = *self.topics.get(&header.channel_id)?;
                Some(Item::Message { topic, time_ns: header.log_time, data: data.into_owned() })
            }
            Record::Metadata(metadata) if metadata.name == METADATA => {
                Some(Item::Metadata(metadata.metadata))
            }
            Record::Attachment { header, data, .. } => {
                Some(Item::Attachment { name: header.name, data: data.into_owned() })
            }
            _ => None,
        }
    }
}
