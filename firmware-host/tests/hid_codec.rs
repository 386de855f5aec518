//! Codecs of HID devices: published bytes, every field where the maker puts it, and no panic on any bytes.
#![allow(clippy::unwrap_used)]

use gelstereo_host::codec::blink1::{self, Blink1Error, Command, Led, Rgb, Version};
use gelstereo_host::codec::tara::{
    Assembly, CalibrationFile, Exposure, Firmware, Packet, Reply, Request, StreamMode, TaraError,
};
use proptest::prelude::*;

/// A report that starts with these bytes and has zeros behind them.
fn report(start: &[u8]) -> [u8; 64] {
    let mut report = [0; 64];
    report[..start.len()].copy_from_slice(start);
    report
}

/// Requests with the first bytes of their report, by the maker's SDK.
const PUBLISHED: [(Request, &[u8]); 12] = [
    (Request::Firmware, &[0x40]),
    (Request::UniqueId, &[0x41]),
    (Request::Exposure, &[0x78, 0x01]),
    (Request::SetExposure(Exposure::Us(8000)), &[0x78, 0x02, 0, 0, 0x1F, 0x40]),
    (Request::SetExposure(Exposure::Auto), &[0x78, 0x02, 0, 0, 0, 1]),
    (Request::CalibrationLength(CalibrationFile::Intrinsic), &[0x78, 0x09, 0]),
    (Request::CalibrationData(CalibrationFile::Extrinsic), &[0x78, 0x0A, 1]),
    (Request::SetStreamMode(StreamMode::Master), &[0x78, 0x0B, 1]),
    (Request::SetStreamMode(StreamMode::Trigger), &[0x78, 0x0B, 0]),
    (Request::StreamMode, &[0x78, 0x0C]),
    (Request::SetHdr(true), &[0x78, 0x0E, 1]),
    (Request::Hdr, &[0x78, 0x0F]),
];

#[test]
fn tara_requests_are_the_makers_bytes() {
    for (request, start) in PUBLISHED {
        assert_eq!(request.encode().unwrap(), report(start), "{request:?}");
    }
}

#[test]
fn tara_replies_have_the_makers_layout() {
    let reply = |request: Request, bytes: &[u8]| request.decode(&report(bytes)).unwrap().unwrap();
    let firmware = Firmware { product: 1, major: 2, minor: 0x0304, revision: 0x0506 };
    assert_eq!(reply(Request::Firmware, &[0x40, 1, 2, 3, 4, 5, 6]), Reply::Firmware(firmware));
    assert_eq!(firmware.to_string(), "1.2.772.1286");
    assert_eq!(reply(Request::UniqueId, &[0x41, 1, 2, 3, 4]), Reply::UniqueId(0x0102_0304));
    let exposure = reply(Request::Exposure, &[0x78, 1, 0, 0, 0x1F, 0x40, 0, 0, 0, 0, 1]);
    assert_eq!(exposure, Reply::Exposure(Exposure::Us(8000)));
    let length = [0x78, 9, 0, 0, 0, 0, 0, 0x02, 0x01, 0, 0, 0, 0, 0, 0, 1];
    let length = reply(Request::CalibrationLength(CalibrationFile::Intrinsic), &length);
    assert_eq!(length, Reply::CalibrationLength(513));
    let mut packet = report(&[0x78, 0x0A, 0, 0, 0, 0x01, 0x02, 1]);
    packet[8..].fill(7);
    let packet = Request::CalibrationData(CalibrationFile::Intrinsic).decode(&packet).unwrap().unwrap();
    assert_eq!(packet, Reply::CalibrationData(Packet { number: 258, data: [7; 56] }));
}

#[test]
fn tara_failures_are_named() {
    let refused = Request::SetHdr(true).decode(&report(&[0x78, 0x0E, 1, 0, 0])).unwrap_err();
    assert_eq!(refused.to_string(), "the camera refuses to switch HDR (status 0; 1 is success)");
    let exposure = Request::SetExposure(Exposure::Us(5)).encode().unwrap_err();
    assert_eq!(exposure.to_string(), "exposure_us is 5; valid is 1 (automatic) or 10 to 1000000 us");
    let mode = Request::StreamMode.decode(&report(&[0x78, 0x0C, 9, 0, 1])).unwrap_err();
    assert_eq!(mode.to_string(), "stream mode is 9; valid is 0 (trigger) or 1 (master)");
}

fn request() -> impl Strategy<Value = Request> {
    let file = || prop_oneof![Just(CalibrationFile::Intrinsic), Just(CalibrationFile::Extrinsic)];
    let exposure = prop_oneof![Just(Exposure::Auto), (10_u32..=1_000_000).prop_map(Exposure::Us)];
    let mode = prop_oneof![Just(StreamMode::Master), Just(StreamMode::Trigger)];
    prop_oneof![
        Just(Request::Firmware),
        Just(Request::UniqueId),
        Just(Request::Exposure),
        exposure.prop_map(Request::SetExposure),
        Just(Request::StreamMode),
        mode.prop_map(Request::SetStreamMode),
        Just(Request::Hdr),
        any::<bool>().prop_map(Request::SetHdr),
        file().prop_map(Request::CalibrationLength),
        file().prop_map(Request::CalibrationData),
    ]
}

/// Bytes that are more often than not a report of the right length that starts as an answer does.
fn answer() -> impl Strategy<Value = Vec<u8>> {
    let starts = prop_oneof![Just(0x40_u8), Just(0x41), Just(0x78)];
    let likely =
        (starts, 0_u8..0x12, proptest::collection::vec(0_u8..3, 62)).prop_map(|(first, second, mut rest)| {
            rest.splice(0..0, [first, second]);
            rest
        });
    prop_oneof![3 => likely, 1 => proptest::collection::vec(any::<u8>(), 0..130)]
}

proptest! {
    #[test]
    fn a_tara_exposure_survives_the_wire(us in 10_u32..=1_000_000) {
        let sent = Request::SetExposure(Exposure::Us(us)).encode().unwrap();
        let mut echoed = sent;
        echoed[10] = 1;
        let reply = Request::SetExposure(Exposure::Auto).decode(&echoed).unwrap();
        prop_assert_eq!(reply, Some(Reply::Exposure(Exposure::Us(us))));
    }

    #[test]
    fn an_exposure_outside_the_range_is_never_sent(
        us in prop_oneof![Just(0), 2_u32..10, 1_000_001..u32::MAX],
    ) {
        let error = Request::SetExposure(Exposure::Us(us)).encode().unwrap_err();
        prop_assert!(matches!(error, TaraError::Value { found, .. } if found == us), "{error:?}");
    }

    /// An answer is taken by the requests whose first bytes it repeats, and by no other.
    #[test]
    fn a_tara_answer_is_matched_by_its_first_bytes(request in request(), bytes in answer()) {
        let sent = request.encode().unwrap();
        let same = match sent[0] {
            0x78 => bytes.len() == 64 && bytes[..2] == sent[..2],
            first => bytes.len() == 64 && bytes[0] == first,
        };
        match request.decode(&bytes) {
            Ok(reply) => prop_assert_eq!(reply.is_some(), same),
            Err(_) => prop_assert!(same),
        }
    }

    #[test]
    fn a_status_other_than_1_is_refused(
        request in request(), mut bytes in proptest::collection::vec(any::<u8>(), 64),
    ) {
        let sent = request.encode().unwrap();
        bytes[..2].copy_from_slice(&sent[..2]);
        let status = match sent[..2] {
            [0x78, 0x01 | 0x02] => 10,
            [0x78, 0x09] => 15,
            [0x78, 0x0A] => 7,
            [0x78, _] => 4,
            _ => return Ok(()),
        };
        prop_assume!(bytes[status] != 1);
        let refused = matches!(
            request.decode(&bytes),
            Err(TaraError::Refused { status: found, .. }) if found == bytes[status]
        );
        prop_assert!(refused);
    }

    #[test]
    fn a_calibration_file_is_put_together_again(
        file in proptest::collection::vec(any::<u8>(), 0..600),
        first in 0_u16..=1,
        lost in any::<proptest::sample::Index>(),
    ) {
        let packets: Vec<_> = (first..)
            .zip(file.chunks(56))
            .map(|(number, part)| {
                let mut data = [0xEE; 56];
                data[..part.len()].copy_from_slice(part);
                Packet { number, data }
            })
            .collect();
        let length = u16::try_from(file.len()).unwrap();
        let mut whole = Assembly::new(length);
        for packet in &packets {
            prop_assert!(!whole.is_complete());
            whole.push(packet).unwrap();
        }
        prop_assert!(whole.is_complete());
        prop_assert_eq!(whole.into_bytes(), file);

        // Without one of its packets, but the last, the file is refused at the next one.
        prop_assume!(packets.len() > 2);
        let lost = 1 + lost.index(packets.len() - 2);
        let mut broken = Assembly::new(length);
        let results: Vec<_> = packets
            .iter()
            .enumerate()
            .filter(|(at, _)| *at != lost)
            .map(|(_, packet)| broken.push(packet))
            .collect();
        let error = TaraError::Packet { expected: packets[lost].number, found: packets[lost + 1].number };
        prop_assert_eq!(results[lost], Err(error));
    }

    #[test]
    fn a_blink1_color_stands_where_the_document_puts_it(
        (red, green, blue) in any::<(u8, u8, u8)>(),
        fade_ms in 0..=blink1::MAX_FADE_MS,
    ) {
        let color = Rgb { red, green, blue };
        let [high, low] = u16::try_from(fade_ms / 10).unwrap().to_be_bytes();
        let fade = Command::Fade { color, fade_ms, led: Led::Second }.encode().unwrap();
        prop_assert_eq!(fade, [1, b'c', red, green, blue, high, low, 2, 0]);
        let set = Command::Set { color, led: Led::All }.encode().unwrap();
        prop_assert_eq!(set, [1, b'n', red, green, blue, 0, 0, 0, 0]);
        prop_assert_eq!(Rgb::decode(&[1, b'r', red, green, blue, 0, 0, 0, 0]), Ok(color));
    }

    #[test]
    fn blink1_answers_of_any_bytes_are_read_or_refused(
        bytes in proptest::collection::vec(any::<u8>(), 0..20),
    ) {
        let starts = |letter| bytes.len() >= 5 && bytes[..2] == [1, letter];
        prop_assert_eq!(Rgb::decode(&bytes).is_ok(), starts(b'r'));
        prop_assert!(Version::decode(&bytes).is_err() || starts(b'v'));
    }

    #[test]
    fn a_longer_fade_is_refused(fade_ms in blink1::MAX_FADE_MS + 10..=u32::MAX) {
        let fade = Command::Fade { color: Rgb::default(), fade_ms, led: Led::All };
        prop_assert_eq!(fade.encode(), Err(Blink1Error::Fade { found_ms: fade_ms }));
    }

    #[test]
    fn a_scaled_color_is_never_brighter(level in any::<u8>(), brightness in -1.0..2.0) {
        let color = Rgb { red: level, green: 255, blue: 0 }.scaled(brightness);
        prop_assert!(color.red <= level);
        prop_assert_eq!(f64::from(color.green), (255.0 * f64::clamp(brightness, 0.0, 1.0)).round());
        prop_assert_eq!(color.blue, 0);
    }
}

/// The kernel's driver hid-led sent these for red 200, green 100, blue 50 on its first light.
#[test]
fn a_blink1_fade_is_what_the_kernels_driver_sends() {
    let color = Rgb { red: 200, green: 100, blue: 50 };
    let fade = Command::Fade { color, fade_ms: 0, led: Led::First }.encode().unwrap();
    assert_eq!(fade, [0x01, 0x63, 0xC8, 0x64, 0x32, 0x00, 0x00, 0x01, 0x00]);
}

/// ThingM's document gives `01 FF` for five seconds; 500 ticks are `01 F4`.
#[test]
fn five_seconds_are_500_ticks() {
    let fade = Command::Fade { color: Rgb::default(), fade_ms: 5000, led: Led::All }.encode().unwrap();
    assert_eq!(fade[5..7], [0x01, 0xF4]);
}

#[test]
fn a_blink1_version_is_two_digits() {
    assert_eq!(Version::decode(&[1, b'v', 0, b'3', b'4', 0, 0, 0, 0]), Ok(Version { major: 3, minor: 4 }));
    let error = Version::decode(&[1, b'v', 0, b'x', b'4']).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the light answered command 'v' with 5 bytes that start [01, 76, 00, 78, 34]; is another program \
        using it?"
    );
}
