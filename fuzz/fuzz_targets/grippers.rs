//! Replies of grippers in pieces, good and damaged: each reader gives what was sent, an error in words, or
//! waits.
#![no_main]

use gelstereo_host::codec::modbus::{Reply, Request, rtu, tcp};
use gelstereo_host::codec::robotiq::Status;
use gelstereo_host::codec::robotiq_urcap::{self, LineReader, Variable};
use gelstereo_host::codec::{dynamixel, feetech, wsg};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// What comes over the line, and whether it is what the device sent.
struct Received {
    pieces: Vec<Vec<u8>>,
    is_whole: bool,
}

/// A reply as the line gives it: as it was sent, with changed, lost or doubled bytes, or any bytes instead.
fn received(u: &mut Unstructured<'_>, mut sent: Vec<u8>) -> Result<Received> {
    let damage = u.int_in_range(0..=5_u8)?;
    let at = if sent.is_empty() { 0 } else { u.int_in_range(0..=sent.len() - 1)? };
    match damage {
        0 | 1 => {}
        2 if !sent.is_empty() => sent[at] ^= u.int_in_range(1..=255)?,
        3 => sent.truncate(at),
        4 => sent.extend_from_within(at..),
        _ => sent = u.arbitrary()?,
    }
    let size = u.int_in_range(1..=40)?;
    Ok(Received { pieces: sent.chunks(size).map(<[u8]>::to_vec).collect(), is_whole: damage < 2 })
}

/// Everything that a reader gives for these pieces; the end is asked for until nothing comes.
fn all<T, E: std::fmt::Display>(
    received: &Received,
    mut push: impl FnMut(&[u8]) -> Option<std::result::Result<T, E>>,
) -> Vec<std::result::Result<T, E>> {
    let bytes: usize = received.pieces.iter().map(Vec::len).sum();
    let mut given = Vec::new();
    for piece in received.pieces.iter().map(Vec::as_slice).chain(std::iter::repeat_n(&[][..], bytes + 1)) {
        given.extend(push(piece));
    }
    assert!(push(&[]).is_none(), "a reader that never ends");
    for error in given.iter().filter_map(|one| one.as_ref().err()) {
        assert!(!error.to_string().is_empty());
    }
    given
}

fn modbus(u: &mut Unstructured<'_>) -> Result<()> {
    let values: Vec<u16> = u.arbitrary()?;
    let (address, count) = (u.arbitrary()?, u.int_in_range(0..=130)?);
    let request = match u.int_in_range(0..=4_u8)? {
        0 => Request::ReadHolding { address, count },
        1 => Request::ReadInput { address, count },
        2 => Request::WriteSingle { address, value: count },
        3 => Request::WriteMultiple { address, values: &values },
        _ => {
            Request::ReadWrite { read_address: address, read_count: count, write_address: 7, values: &values }
        }
    };
    let (unit, transaction) = (u.arbitrary()?, u.arbitrary()?);
    let encoded = rtu::encode(unit, &request);
    assert_eq!(encoded.is_ok(), tcp::encode(transaction, unit, &request).is_ok());
    let Ok(frame) = encoded else { return Ok(()) };
    assert!(frame.len() <= rtu::MAX_FRAME);
    let (body, expected) = answer(u, &request)?;
    if u.arbitrary()? {
        let mut frame = [&[unit], body.as_slice()].concat();
        frame.extend_from_slice(&rtu::crc(&frame).to_le_bytes());
        let received = received(u, frame)?;
        let mut reader = rtu::ReplyReader::new(unit, request);
        assert_replies(&received, all(&received, |piece| reader.push(piece)), &expected);
    } else {
        let length = body.len() as u16 + 1;
        let head = [transaction, 0, length].map(u16::to_be_bytes);
        let received = received(u, [head.as_flattened(), &[unit], &body].concat())?;
        let mut reader = tcp::ReplyReader::new(transaction, unit, request);
        let mut is_lost = false;
        let given = all(&received, |piece| {
            // After an error the connection has lost its place and is closed.
            if is_lost {
                return None;
            }
            let reply = reader.push(piece);
            is_lost = matches!(reply, Some(Err(_)));
            reply
        });
        assert_replies(&received, given, &expected);
    }
    Ok(())
}

/// The protocol data unit of a device that does what it was asked, and what it means.
fn answer(u: &mut Unstructured<'_>, request: &Request<'_>) -> Result<(Vec<u8>, Reply)> {
    let big = |values: &[u16]| values.iter().flat_map(|value| value.to_be_bytes()).collect::<Vec<u8>>();
    let written = |words: [u16; 2]| ([vec![request.function()], big(&words)].concat(), Reply::Written);
    Ok(match *request {
        Request::WriteSingle { address, value } => written([address, value]),
        Request::WriteMultiple { address, values } => written([address, values.len() as u16]),
        Request::ReadHolding { count, .. }
        | Request::ReadInput { count, .. }
        | Request::ReadWrite { read_count: count, .. } => {
            let registers = (0..count).map(|_| u.arbitrary()).collect::<Result<Vec<u16>>>()?;
            let body = [vec![request.function(), 2 * count as u8], big(&registers)].concat();
            (body, Reply::Registers(registers))
        }
    })
}

fn assert_replies<E: std::fmt::Debug>(
    received: &Received,
    given: Vec<std::result::Result<Reply, E>>,
    expected: &Reply,
) {
    if received.is_whole {
        assert!(matches!(given.as_slice(), [Ok(reply)] if reply == expected), "{given:?} for {expected:?}");
    }
    for reply in given.iter().flatten() {
        // A read is answered by as many registers as were asked for, whatever came.
        if let (Reply::Registers(found), Reply::Registers(expected)) = (reply, expected) {
            assert_eq!(found.len(), expected.len());
        }
    }
}

fn servos(u: &mut Unstructured<'_>) -> Result<()> {
    let (id, data): (u8, Vec<u8>) = (u.arbitrary()?, u.arbitrary()?);
    if u.arbitrary()? {
        let write = dynamixel::Instruction::Write { address: u.arbitrary()?, data: &data };
        let received = received(u, write.encode(id))?;
        let mut reader = dynamixel::StatusReader::default();
        let given = all(&received, |piece| reader.push(piece));
        assert!(!received.is_whole || given.is_empty(), "an instruction's echo is no status: {given:?}");
    } else if let Ok(packet) =
        (feetech::Instruction::Write { address: u.arbitrary()?, data: &data }).encode(id)
    {
        let received = received(u, packet.clone())?;
        let mut reader = feetech::StatusReader::after(&packet);
        for status in all(&received, |piece| reader.push(piece)).iter().flatten() {
            assert!(!status.faults.to_string().is_empty() && status.data.len() <= 253);
        }
    }
    Ok(())
}

fn weiss(u: &mut Unstructured<'_>) -> Result<()> {
    let (id, status): (u8, u16) = (u.arbitrary()?, u.arbitrary()?);
    let data: Vec<u8> = u.arbitrary()?;
    let received = received(u, wsg::frame(id, &[&status.to_le_bytes(), data.as_slice()].concat()))?;
    let mut reader = wsg::ReplyReader::default();
    for reply in all(&received, |piece| reader.push(piece)).iter().flatten() {
        if let Err(error) = reply.is_done() {
            assert!(!error.to_string().is_empty());
        }
        let _ = reply.float();
        assert!(!received.is_whole || (reply.id, reply.status, &reply.data) == (id, status, &data));
    }
    Ok(())
}

fn robotiq(u: &mut Unstructured<'_>) -> Result<()> {
    let status = Status::from_registers(u.arbitrary()?);
    assert!(!status.fault.to_string().is_empty());
    let number: u8 = u.arbitrary()?;
    let received = received(u, format!("POS {number}\n").into_bytes())?;
    let mut reader = LineReader::default();
    let given = all(&received, |piece| reader.push(piece));
    let values = given.iter().flatten().map(|line| robotiq_urcap::value(line, Variable::Pos));
    let values: Vec<u8> = values.flatten().collect();
    assert!(!received.is_whole || values == [number]);
    given.iter().flatten().for_each(|line| drop(robotiq_urcap::acknowledged(line)));
    Ok(())
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    while !u.is_empty() {
        match u.int_in_range(0..=3_u8)? {
            0 => modbus(&mut u)?,
            1 => servos(&mut u)?,
            2 => weiss(&mut u)?,
            _ => robotiq(&mut u)?,
        }
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
