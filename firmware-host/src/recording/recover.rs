//! Copies the readable part of a truncated or damaged recording.

use super::RecordingError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Serialize;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::Path;

/// Longest record; longer ones are damage. One chunk is far below it.
const MAX_RECORD_BYTES: u64 = 1 << 28;
/// Opcode and length before each record.
const RECORD_HEAD_BYTES: usize = 9;

/// What was copied and what was lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Recovered {
    /// Messages copied.
    pub messages: u64,
    /// Log time from the first to the last message.
    pub duration_ns: u64,
    /// Whether the recording was complete.
    pub complete: bool,
    /// Complete chunks with a wrong checksum; none of their messages was copied.
    pub damaged_chunks: u64,
    /// Bytes after the last complete record; whole messages among them were copied.
    pub cut_bytes: u64,
}

impl std::fmt::Display for Recovered {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let seconds = self.duration_ns as f64 * 1e-9;
        writeln!(f, "{} messages over {seconds:.3} s copied, with index and end mark", self.messages)?;
        if self.damaged_chunks > 0 {
            writeln!(f, "lost: {} chunks that are damaged within the file", self.damaged_chunks)?;
        }
        match (self.complete, self.cut_bytes) {
            (true, _) => write!(f, "the recording was complete"),
            (false, 0) => write!(f, "the recording was not closed; it ends after a complete record"),
            (false, bytes) => write!(
                f,
                "the recording was cut off; its last {bytes} bytes are part of a record, of which whole \
                 messages were copied"
            ),
        }
    }
}

/// Copies every complete message and all metadata and attachments of the MCAP file `input` to the new
/// file `output`, and writes an index. `input` is not modified.
///
/// # Errors
/// [`RecordingError::Io`] when a file cannot be opened or created, or `output` exists;
/// [`RecordingError::Format`] when `input` is not an MCAP file; [`RecordingError::Disk`] when the disk is
/// full.
pub fn recover(input: &Path, output: &Path) -> Result<Recovered, RecordingError> {
    let io = |path: &Path, doing| {
        let path = path.to_owned();
        move |error| RecordingError::Io { path, doing, error }
    };
    let mut source = BufReader::new(File::open(input).map_err(io(input, "open"))?);
    let mut magic = [0; mcap::MAGIC.len()];
    if source.read_exact(&mut magic).is_err() || magic != *mcap::MAGIC {
        return Err(RecordingError::Format(mcap::McapError::BadMagic));
    }
    let target = File::create_new(output).map_err(io(output, "create"))?;
    let mut copy = Copy::new(target)?;
    while copy.record(&mut source)? {}
    let recovered = copy.finish()?;
    Ok(recovered)
}

struct Copy {
    writer: mcap::Writer<BufWriter<File>>,
    recovered: Recovered,
    times_ns: Option<(u64, u64)>,
}

impl Copy {
    fn new(target: File) -> Result<Self, RecordingError> {
        let writer = mcap::WriteOptions::new()
            .compression(Some(mcap::Compression::Lz4))
            .profile("ros2")
            .library(concat!("gelstereo-host ", env!("CARGO_PKG_VERSION"), " recover"))
            .create(BufWriter::new(target))
            .map_err(RecordingError::writing)?;
        Ok(Self { writer, recovered: Recovered::default(), times_ns: None })
    }

    /// Copies one record; `false` after the last one.
    fn record(&mut self, source: &mut impl Read) -> Result<bool, RecordingError> {
        let mut bytes = Vec::new();
        let take = |source: &mut dyn Read, bytes: &mut Vec<u8>, count: u64| {
            source.take(count).read_to_end(bytes).map_err(RecordingError::Disk)
        };
        take(source, &mut bytes, RECORD_HEAD_BYTES as u64)?;
        if bytes.is_empty() {
            return Ok(false);
        }
        let length =
            bytes.get(1..).and_then(<[u8]>::first_chunk).map_or(u64::MAX, |&l| u64::from_le_bytes(l));
        let opcode = bytes[0];
        let known = (op::HEADER..=op::DATA_END).contains(&opcode) && length <= MAX_RECORD_BYTES;
        let read = if known { take(source, &mut bytes, length)? as u64 } else { 0 };
        if !known || read < length {
            let rest = std::io::copy(source, &mut std::io::sink()).map_err(RecordingError::Disk)?;
            self.recovered.cut_bytes = bytes.len() as u64 + rest;
            if known && opcode == op::CHUNK {
                self.chunk(&bytes, false)?;
            }
            return Ok(false);
        }
        match opcode {
            op::DATA_END => {
                self.recovered.complete = true;
                return Ok(false);
            }
            op::CHUNK => {
                let whole = self.chunk(&bytes, true)?;
                self.recovered.damaged_chunks += u64::from(!whole);
            }
            _ => {
                let record = mcap::parse_record(opcode, &bytes[RECORD_HEAD_BYTES..]);
                if let Ok(record) = record {
                    self.copy(record)?;
                }
            }
        }
        Ok(true)
    }

    /// Copies the contents of a chunk. The checksum of a `whole` chunk is verified first; returns whether
    /// it is correct.
    fn chunk(&mut self, bytes: &[u8], whole: bool) -> Result<bool, RecordingError> {
        let mut reader = LinearReader::new_with_options(
            LinearReaderOptions::default()
                .with_skip_start_magic(true)
                .with_skip_end_magic(true)
                .with_prevalidate_chunk_crcs(whole)
                .with_record_length_limit(MAX_RECORD_BYTES as usize),
        );
        let mut rest = bytes;
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(count)) => {
                    let count = count.min(rest.len());
                    reader.insert(count).copy_from_slice(&rest[..count]);
                    reader.notify_read(count);
                    rest = &rest[count..];
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    let Ok(record) = mcap::parse_record(opcode, data) else { return Ok(false) };
                    self.copy(record.into_owned())?;
                }
                Err(_) => return Ok(false),
            }
        }
        Ok(true)
    }

    fn copy(&mut self, record: Record<'_>) -> Result<(), RecordingError> {
        let result = match record {
            Record::Schema { header, data } => {
                self.writer.add_schema_with_id(header.id, &header.name, &header.encoding, &data).map(|_| ())
            }
            Record::Channel(c) => self
                .writer
                .add_channel_with_id(c.id, c.schema_id, &c.topic, &c.message_encoding, &c.metadata)
                .map(|_| ()),
            Record::Message { header, data } => {
                let (first_ns, last_ns) = self.times_ns.unwrap_or((header.log_time, header.log_time));
                self.times_ns = Some((first_ns.min(header.log_time), last_ns.max(header.log_time)));
                self.recovered.messages += 1;
                self.writer.write_to_known_channel(&header, &data)
            }
            Record::Metadata(metadata) => self.writer.write_metadata(&metadata),
            Record::Attachment { header, data, .. } => self.writer.attach(&mcap::Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            }),
            _ => Ok(()),
        };
        result.map_err(RecordingError::writing)
    }

    fn finish(mut self) -> Result<Recovered, RecordingError> {
        self.writer.finish().map_err(RecordingError::writing)?;
        let mut file = self.writer.into_inner();
        file.flush().map_err(RecordingError::Disk)?;
        file.get_ref().sync_data().map_err(RecordingError::Disk)?;
        self.recovered.duration_ns = self.times_ns.map_or(0, |(first_ns, last_ns)| last_ns - first_ns);
        Ok(self.recovered)
    }
}
