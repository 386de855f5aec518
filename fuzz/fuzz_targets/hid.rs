//! Answers of HID devices: any bytes are an answer, no answer, or refused by name; files are never longer
//! than stated.
#![no_main]

use gelstereo_host::codec::blink1::{Rgb, Version};
use gelstereo_host::codec::tara::{Assembly, CalibrationFile, Exposure, Packet, Reply, Request, StreamMode};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

fn request(u: &mut Unstructured<'_>) -> Result<Request> {
    let file = if u.arbitrary()? { CalibrationFile::Intrinsic } else { CalibrationFile::Extrinsic };
    Ok(match u.int_in_range(0..=9_u8)? {
        0 => Request::Firmware,
        1 => Request::UniqueId,
        2 => Request::Exposure,
        3 => Request::SetExposure(Exposure::Us(u.arbitrary()?)),
        4 => Request::StreamMode,
        5 => Request::SetStreamMode(if u.arbitrary()? { StreamMode::Master } else { StreamMode::Trigger }),
        6 => Request::Hdr,
        7 => Request::SetHdr(u.arbitrary()?),
        8 => Request::CalibrationLength(file),
        _ => Request::CalibrationData(file),
    })
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let request = request(&mut u)?;
    if let (Request::SetExposure(exposure), sent) = (request, request.encode()) {
        assert_eq!(sent.is_ok(), Exposure::from_us(exposure.us()).is_ok());
    }
    let mut assembly = Assembly::new(u.arbitrary()?);
    while !u.is_empty() {
        let length = if u.ratio(7, 8)? { 64 } else { u.int_in_range(0..=70)? };
        let mut report = u.bytes(length.min(u.len()))?.to_vec();
        // A start that fits is rare by chance.
        if let (Ok(sent), true, true) = (request.encode(), report.len() >= 2, u.arbitrary()?) {
            report[..2].copy_from_slice(&sent[..2]);
        }
        match request.decode(&report) {
            Ok(Some(Reply::CalibrationData(Packet { number, data }))) => {
                let before = assembly.bytes().len();
                let taken = assembly.push(&Packet { number, data }).is_ok();
                assert!(taken || assembly.bytes().len() == before);
                assert!(assembly.bytes().len() - before <= data.len());
            }
            Ok(Some(Reply::Exposure(exposure))) => assert_eq!(Exposure::from_us(exposure.us()), Ok(exposure)),
            Ok(Some(_)) => assert!(report.len() == 64),
            Ok(None) => {}
            Err(error) => assert!(!error.to_string().is_empty()),
        }
        if let Ok(version) = Version::decode(&report) {
            assert!(version.major <= 9 && version.minor <= 9);
        }
        if let Err(error) = Rgb::decode(&report) {
            assert!(!error.to_string().is_empty());
        }
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
