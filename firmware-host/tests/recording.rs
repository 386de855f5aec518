//! Recordings as files: what was written is read, and nothing before a cut is lost.
#![allow(clippy::unwrap_used)]

use gelstereo_host::recording::{Item, METADATA_CONFIG, Reader, Recorder, SharedBuffer, Topic, messages};
use gelstereo_host::source::Gray;
use proptest::prelude::*;
use std::io::Cursor;

/// A recording, and its length after every frame.
fn frames(count: u64) -> (Vec<u8>, Vec<usize>) {
    let buffer = SharedBuffer::default();
    let mesh = ("part.stl".to_owned(), vec![1, 2, 3]);
    let mut recorder = Recorder::new(Box::new(buffer.clone()), "preset = \"paper\"", &[mesh]).unwrap();
    let mut ends = Vec::new();
    for frame in 0..count {
        let image = Gray { width: 3, height: 2, pixels: vec![frame as u8; 6] };
        let time_ns = frame * 33_333_333;
        let left = messages::image(time_ns, messages::SENSOR_FRAME, &image);
        recorder.write(Topic::LeftImage, time_ns, &left).unwrap();
        recorder.write(Topic::Frame, time_ns, &messages::string(&frame.to_string())).unwrap();
        recorder.flush().unwrap();
        ends.push(buffer.bytes().len());
    }
    recorder.finish().unwrap();
    (buffer.bytes(), ends)
}

/// All items, and whether the end was missing.
fn read(bytes: &[u8]) -> (Vec<Item>, bool) {
    let mut reader = Reader::new(Box::new(Cursor::new(bytes.to_vec())));
    let mut items = Vec::new();
    while let Some(item) = reader.next_item().unwrap() {
        items.push(item);
    }
    assert_eq!(reader.next_item().unwrap(), None, "the end stays the end");
    (items, reader.truncated())
}

#[test]
fn what_was_written_is_read_in_its_order() {
    let (items, truncated) = read(&frames(3).0);
    assert!(!truncated);
    let Item::Metadata(entries) = &items[0] else { panic!("{:?}", items[0]) };
    assert_eq!(entries[METADATA_CONFIG], "preset = \"paper\"");
    assert_eq!(items[1], Item::Attachment { name: "part.stl".to_owned(), data: vec![1, 2, 3] });
    assert_eq!(items.len(), 2 + 3 * 2);
    let Item::Message { topic: Topic::LeftImage, time_ns, data } = &items[6] else {
        panic!("{:?}", items[6])
    };
    let mut image = Gray::default();
    assert_eq!(messages::read_image(data, &mut image).unwrap(), *time_ns);
    assert_eq!((*time_ns, image), (66_666_666, Gray { width: 3, height: 2, pixels: vec![2; 6] }));
    let Item::Message { topic: Topic::Frame, data, .. } = &items[7] else { panic!("{:?}", items[7]) };
    assert_eq!(messages::read_string(data).unwrap(), "2");
}

/// At every byte: no error, the items before the cut are those of the whole file, and each frame whose chunk is whole
/// is among them.
#[test]
fn a_cut_anywhere_loses_nothing_before_it() {
    let (bytes, ends) = frames(4);
    let (whole, _) = read(&bytes);
    for cut in 0..bytes.len() {
        let (items, truncated) = read(&bytes[..cut]);
        assert!(truncated, "cut at {cut} of {}", bytes.len());
        let frames = ends.iter().filter(|&&end| end <= cut).count();
        let least = if frames > 0 { 2 + 2 * frames } else { 0 };
        assert!(items.len() >= least && items[..] == whole[..items.len()], "cut at {cut}: {items:?}");
    }
}

proptest! {
    /// Whatever the bytes are, reading ends, with items or with an error, and does not panic.
    #[test]
    fn damage_is_an_error_or_a_shorter_recording(at in 0_usize..4000, mask in 1_u8..) {
        let (mut bytes, _) = frames(3);
        let at = at % bytes.len();
        bytes[at] ^= mask;
        let mut reader = Reader::new(Box::new(Cursor::new(bytes)));
        let mut items = 0;
        while let Ok(Some(_)) = reader.next_item() {
            items += 1;
            prop_assert!(items <= 8, "more items than were written");
        }
    }
}
