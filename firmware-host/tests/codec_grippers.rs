//! Codecs of grippers against bytes that their makers and drivers published, and against damaged lines.
#![allow(clippy::unwrap_used)]

use gelstereo_host::codec::modbus::{ModbusError, Reply, Request, rtu, tcp};
use gelstereo_host::codec::robotiq::{self, Activation, Command, Fault, Motion, Status};
use gelstereo_host::codec::robotiq_urcap::{self, LineReader, Variable};
use gelstereo_host::codec::{dynamixel, feetech, wsg};
use proptest::prelude::*;

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// Frames of the 2F-85's instruction manual.
#[test]
fn robotiq_frames_are_those_of_the_manual() {
    let write = |command: Command| {
        let values = command.registers();
        let request = Request::WriteMultiple { address: robotiq::COMMAND_ADDRESS, values: &values };
        rtu::encode(robotiq::DEFAULT_UNIT, &request).unwrap()
    };
    let active = Command { activate: true, ..Command::default() };
    let close = Command { go: true, position: 255, speed: 255, force: 255, ..active };
    assert_eq!(write(Command::default()), bytes("09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30"));
    assert_eq!(write(active), bytes("09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1"));
    assert_eq!(write(close), bytes("09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29"));
    let open = Command { position: 0, ..close };
    assert_eq!(write(open), bytes("09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19"));
    assert_eq!(rtu::encode(9, &robotiq::READ_STATUS).unwrap(), bytes("09 03 07 D0 00 03 04 0E"));
    let input = Request::ReadInput { address: robotiq::STATUS_ADDRESS, count: 3 };
    assert_eq!(rtu::encode(9, &input).unwrap(), bytes("09 04 07 D0 00 03 B1 CE"));
    let values = close.registers();
    let expected = bytes("09 17 07 D0 00 03 03 E8 00 03 06 09 00 00 FF FF FF E6 3E");
    assert_eq!(rtu::encode(9, &robotiq::exchange(&values)).unwrap(), expected);
    let request = Request::WriteMultiple { address: 1000, values: &[0, 0, 0] };
    let mut reader = rtu::ReplyReader::new(9, request);
    assert_eq!(reader.push(&bytes("09 10 03 E8 00 03 01 30")), Some(Ok(Reply::Written)));
}

#[test]
fn robotiq_status_is_read_as_the_manual_says() {
    let activating = Status::from_registers([0x1100, 0, 0]);
    assert_eq!((activating.activation, activating.activated), (Activation::Activating, true));
    let moving = Status::from_registers([0x3900, 0x00FF, 0x0E0A]);
    assert_eq!((moving.activation, moving.motion), (Activation::Active, Motion::Moving));
    assert_eq!((moving.requested, moving.position, moving.current), (255, 14, 10));
    let gripped = Status::from_registers([0xB900, 0x00FF, 0xBD00]);
    assert_eq!((gripped.motion, gripped.position, gripped.go), (Motion::ContactClosing, 189, true));
    let opened = Status::from_registers([0xF900, 0, 0x0D00]);
    assert_eq!((opened.motion, opened.position), (Motion::Arrived, 13));
    let fault = Status::from_registers([0x3100, 0x0900, 0]).fault;
    assert!(
        fault == Fault(9) && !fault.needs_activation() && fault.to_string().contains("poll it more often")
    );
    assert!(Fault(0xA).needs_activation() && Fault(0).is_none());
}

/// Frames of the PGE-2's manual.
#[test]
fn single_registers_are_written_as_dh_robotics_prints_them() {
    for (address, value, frame) in [
        (0x0100, 0x0001, "01 06 01 00 00 01 49 F6"),
        (0x0101, 30, "01 06 01 01 00 1E 59 FE"),
        (0x0103, 500, "01 06 01 03 01 F4 78 21"),
    ] {
        let request = Request::WriteSingle { address, value };
        assert_eq!(rtu::encode(1, &request).unwrap(), bytes(frame));
        assert_eq!(rtu::ReplyReader::new(1, request).push(&bytes(frame)), Some(Ok(Reply::Written)));
    }
}

#[test]
fn late_and_foreign_replies_are_recognised() {
    let read = |address| Request::ReadHolding { address, count: 1 };
    let late = [0, 7, 0, 0, 0, 5, 65, 3, 2, 0, 9];
    let good = [0, 8, 0, 0, 0, 5, 65, 3, 2, 0, 1];
    let mut reader = tcp::ReplyReader::new(8, 65, read(1));
    assert_eq!(reader.push(&late), None);
    assert_eq!(reader.push(&good), Some(Ok(Reply::Registers(vec![1]))));
    assert_eq!(reader.late(), 1);
    let other_unit = [0, 8, 0, 0, 0, 5, 66, 3, 2, 0, 1];
    let mut reader = tcp::ReplyReader::new(8, 65, read(1));
    assert!(matches!(reader.push(&other_unit), Some(Err(ModbusError::Foreign { field: "unit", .. }))));
    let mut reader = rtu::ReplyReader::new(9, Request::WriteSingle { address: 5, value: 1 });
    let other_register = rtu::encode(9, &Request::WriteSingle { address: 4, value: 1 }).unwrap();
    assert!(matches!(reader.push(&other_register), Some(Err(ModbusError::Foreign { field: "address", .. }))));
    let mut reader = rtu::ReplyReader::new(9, read(1));
    let mut refusal = vec![9, 0x83, 2];
    refusal.extend_from_slice(&rtu::crc(&refusal).to_le_bytes());
    let error = reader.push(&refusal).unwrap().unwrap_err();
    assert_eq!(error, ModbusError::Exception { function: 3, code: 2 });
    assert!(error.to_string().contains("does not have this register"));
}

/// The seven frames that its drivers and notes publish.
#[test]
fn wsg_checksums_are_those_of_published_frames() {
    for frame in ["AA AA AA 20 02 00 00 00 B3 FD", "AA AA AA 21 02 00 1A 00 67 CB"] {
        let frame = bytes(frame);
        let reply = wsg::ReplyReader::default().push(&frame).unwrap().unwrap();
        assert_eq!(reply.is_done(), Ok(frame[3] == 0x20));
    }
    assert_eq!(wsg::frame(1, &[]), bytes("AA AA AA 01 00 00 E8 10"));
    let unknown = wsg::Reply { id: 0x21, status: 0x0E, data: vec![] };
    assert!(unknown.is_done().unwrap_err().to_string().contains("the command is unknown"));
}

/// Examples of the e-Manual: ping, its status, and a read of the present position.
#[test]
fn dynamixel_packets_are_those_of_the_manual() {
    assert_eq!(dynamixel::Instruction::Ping.encode(1), bytes("FF FF FD 00 01 03 00 01 19 4E"));
    let read = dynamixel::Instruction::Read { address: 132, count: 4 };
    assert_eq!(read.encode(1), bytes("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"));
    let write = dynamixel::Instruction::Write { address: 116, data: &512_u32.to_le_bytes() };
    assert_eq!(write.encode(1), bytes("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"));
    let status = bytes("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0");
    let status = dynamixel::StatusReader::default().push(&status).unwrap().unwrap();
    assert_eq!((status.id, status.data), (1, vec![0xA6, 0, 0, 0]));
}

/// Examples of the STS servos' protocol manual: ping, and a read of the present position of servo 1.
#[test]
fn feetech_packets_have_the_published_checksums() {
    assert_eq!(feetech::Instruction::Ping.encode(1).unwrap(), bytes("FF FF 01 02 01 FB"));
    let read = feetech::Instruction::Read { address: 0x38, count: 2 };
    let packet = read.encode(1).unwrap();
    assert_eq!(packet, bytes("FF FF 01 04 02 38 02 BE"));
    let mut reader = feetech::StatusReader::after(&packet);
    assert_eq!(reader.push(&packet), None, "the echo is no reply");
    let status = reader.push(&bytes("FF FF 01 04 00 18 05 DD")).unwrap().unwrap();
    assert_eq!(
        (status.id, status.data, status.faults.to_string()),
        (1, vec![0x18, 5], "no fault".to_owned())
    );
    assert_eq!((feetech::signed(0x8003, 15), feetech::signed(3, 15)), (-3, 3));
}

/// A servo that reports its first fault in reply to a ping sends the ping's own bytes: after the echo they
/// are a reply.
#[test]
fn a_reply_that_equals_its_request_is_no_second_echo() {
    let ping = feetech::Instruction::Ping.encode(1).unwrap();
    let mut reader = feetech::StatusReader::after(&ping);
    assert_eq!(reader.push(&ping), None);
    let status = reader.push(&ping).unwrap().unwrap();
    assert_eq!((status.id, status.data, status.faults), (1, vec![], feetech::Faults(0x01)));
}

#[test]
fn urcap_lines_are_split_and_read() {
    assert_eq!(robotiq_urcap::set(&[(Variable::Pos, 255), (Variable::Gto, 1)]), "SET POS 255 GTO 1\n");
    assert_eq!(robotiq_urcap::get(Variable::Obj), "GET OBJ\n");
    let mut reader = LineReader::default();
    assert_eq!(reader.push(b"OBJ"), None);
    assert_eq!(robotiq_urcap::value(&reader.push(b" 2\nack").unwrap().unwrap(), Variable::Obj), Ok(2));
    assert_eq!(robotiq_urcap::acknowledged(&reader.push(b"").unwrap().unwrap()), Ok(()));
    assert!(robotiq_urcap::value("POS 300", Variable::Pos).is_err());
}

fn request() -> impl Strategy<Value = (u8, u16, Vec<u16>)> {
    (0_u8..5, any::<u16>(), prop::collection::vec(any::<u16>(), 1..20))
}

fn of(kind: u8, address: u16, values: &[u16]) -> Request<'_> {
    let count = values.len() as u16;
    match kind {
        0 => Request::ReadHolding { address, count },
        1 => Request::ReadInput { address, count },
        2 => Request::WriteSingle { address, value: values[0] },
        3 => Request::WriteMultiple { address, values },
        _ => Request::ReadWrite { read_address: address, read_count: count, write_address: 7, values },
    }
}

/// The protocol data unit of a device that does what it was asked, with these values in its registers.
fn answer(request: &Request<'_>, values: &[u16]) -> Vec<u8> {
    let big = |values: &[u16]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    match *request {
        Request::WriteSingle { address, value } => [vec![6], big(&[address, value])].concat(),
        Request::WriteMultiple { address, values } => {
            [vec![16], big(&[address, values.len() as u16])].concat()
        }
        _ => [vec![request.function(), 2 * values.len() as u8], big(values)].concat(),
    }
}

proptest! {
    /// However a reply is cut into pieces and whatever noise stands before it, it is read.
    #[test]
    fn a_reply_in_pieces_is_read(
        (kind, address, values) in request(),
        // The unit's own address would start a frame, and is left out of the noise.
        noise in prop::collection::vec((0_u8..255).prop_map(|b| if b == 9 { 255 } else { b }), 0..10),
        cut in 1_usize..9,
    ) {
        let request = of(kind, address, &values);
        let mut frame = vec![9];
        frame.extend(answer(&request, &values));
        frame.extend_from_slice(&rtu::crc(&frame).to_le_bytes());
        let line = [noise.clone(), frame].concat();
        let mut reader = rtu::ReplyReader::new(9, request);
        let replies: Vec<_> = line.chunks(cut).filter_map(|piece| reader.push(piece)).collect();
        let expected = if matches!(kind, 2 | 3) { Reply::Written } else { Reply::Registers(values.clone()) };
        prop_assert_eq!(replies, vec![Ok(expected)]);
        prop_assert_eq!(reader.skipped(), noise.len());
    }

    /// One damaged byte never gives another value: no reply, an error, or the reply of a later frame.
    #[test]
    fn a_damaged_reply_is_never_believed(
        (kind, address, values) in request(), at in any::<prop::sample::Index>(), mask in 1_u8..,
    ) {
        let request = of(kind, address, &values);
        let mut frame = vec![9];
        frame.extend(answer(&request, &values));
        frame.extend_from_slice(&rtu::crc(&frame).to_le_bytes());
        let at = at.index(frame.len());
        frame[at] ^= mask;
        prop_assert!(!matches!(rtu::ReplyReader::new(9, request).push(&frame), Some(Ok(_))));
    }

    /// Any bytes end without a panic, and readers keep no more than one frame.
    #[test]
    fn readers_survive_any_bytes(line in prop::collection::vec(any::<u8>(), 0..600), cut in 1_usize..64) {
        let request = Request::ReadHolding { address: 0, count: 3 };
        let mut rtu = rtu::ReplyReader::new(9, request);
        let mut tcp = tcp::ReplyReader::new(1, 1, request);
        let (mut wsg, mut dynamixel) = (wsg::ReplyReader::default(), dynamixel::StatusReader::default());
        let (mut feetech, mut urcap) = (feetech::StatusReader::default(), LineReader::default());
        for piece in line.chunks(cut) {
            let _ = (rtu.push(piece), tcp.push(piece), wsg.push(piece), dynamixel.push(piece));
            let _ = (feetech.push(piece), urcap.push(piece));
        }
    }

    /// Parameters with the header's bytes in them come back whole.
    #[test]
    fn stuffed_packets_come_back(
        data in prop::collection::vec(prop::sample::select(vec![0xFF_u8, 0xFD, 0, 7]), 0..40),
    ) {
        let written = dynamixel::Instruction::Write { address: 0x0055, data: &data };
        // An own instruction on the bus is no status.
        prop_assert_eq!(dynamixel::StatusReader::default().push(&written.encode(3)), None);
        let inner = written.encode(3);
        let header = inner[7..inner.len() - 2].windows(4).any(|w| w == [0xFF, 0xFF, 0xFD, 0x00]);
        prop_assert!(!header, "{:02x?}", inner);
    }
}
