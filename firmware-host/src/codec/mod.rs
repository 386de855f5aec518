//! Protocols without transport: they map bytes to bytes. The host, the Python bindings and the fuzzers
//! share them.

pub mod blink1;
pub mod dynamixel;
pub mod feetech;
pub mod frame_stream;
pub mod modbus;
pub mod robotiq;
pub mod robotiq_urcap;
pub mod tara;
pub mod wsg;
