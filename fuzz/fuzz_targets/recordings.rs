//! Recordings that were cut off or damaged: the reader and `recover` give what is whole, or refuse it in
//! words; what was recovered is complete, and as long as they say.
#![no_main]

use gelstereo_host::config::RecordingConfig;
use gelstereo_host::recording::{
    Content, Item, LogClock, MessageSink, Reader, Recording, SharedBuffer, Topic, messages, recover,
};
use gelstereo_host::source::{Gray, StereoPair};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::OnceLock;

/// A short recording of small pairs.
fn recorded() -> &'static [u8] {
    static MADE: OnceLock<Vec<u8>> = OnceLock::new();
    MADE.get_or_init(|| {
        let buffer = SharedBuffer::default();
        let store = buffer.clone();
        let content = Content { config_toml: "seed = 1".to_owned(), attachments: Vec::new() };
        let open = Box::new(move |_| Ok((PathBuf::from("fuzzed"), Box::new(store.clone()) as _)));
        let recording = Recording::with_stores(&RecordingConfig::default(), content, LogClock::Source, open);
        let mut recording = recording.unwrap_or_else(|error| panic!("{error}"));
        let gray = Gray { width: 8, height: 4, pixels: (0..32).collect() };
        for index in 0..40 {
            let time_ns = index * 100_000_000;
            let pair =
                StereoPair { time_ns, left: gray.clone(), right: gray.clone(), ..StereoPair::default() };
            recording.write_pair(&pair);
            recording.write(Topic::Frame, time_ns, &messages::string("{}"));
        }
        assert_eq!(recording.finish().fault, None);
        buffer.bytes()
    })
}

fn damaged(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut bytes = recorded().to_vec();
    for _ in 0..u.int_in_range(0..=4_u8)? {
        let at = u.int_in_range(0..=bytes.len().max(1) - 1)?;
        match u.int_in_range(0..=4_u8)? {
            0 => bytes.truncate(at),
            1 => bytes.splice(at..at, u.arbitrary::<Vec<u8>>()?).for_each(drop),
            2 => bytes.drain(at..(at + usize::from(u.arbitrary::<u8>()?)).min(bytes.len())).for_each(drop),
            // A length of a record.
            3 if at + 8 <= bytes.len() => {
                bytes[at..at + 8].copy_from_slice(&u.arbitrary::<u64>()?.to_le_bytes())
            }
            _ if at < bytes.len() => bytes[at] = u.arbitrary()?,
            _ => {}
        }
    }
    Ok(bytes)
}

/// Messages up to the end or the first error.
fn messages_of(input: Box<dyn std::io::Read>) -> (u64, bool) {
    let (mut reader, mut count) = (Reader::new(input), 0);
    loop {
        match reader.next_item() {
            Ok(Some(Item::Message { .. })) => count += 1,
            Ok(Some(_)) => {}
            Ok(None) => return (count, true),
            Err(error) => {
                assert!(!error.to_string().is_empty());
                return (count, false);
            }
        }
    }
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let bytes = damaged(&mut u)?;
    let _ = messages_of(Box::new(std::io::Cursor::new(bytes.clone())));
    let folder = std::env::temp_dir().join(format!("gelstereo-fuzz-{}", std::process::id()));
    let (input, output) = (folder.join("in.mcap"), folder.join("out.mcap"));
    let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&input, &bytes));
    assert!(written.is_ok(), "{written:?}");
    let _ = std::fs::remove_file(&output);
    match recover(&input, &output) {
        Ok(recovered) => {
            let file = std::fs::File::open(&output).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(messages_of(Box::new(file)), (recovered.messages, true), "{recovered:?}");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    let _ = std::fs::remove_dir_all(&folder);
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
