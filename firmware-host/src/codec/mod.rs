//! Protocols without transport: bytes in, bytes out. The host, the Python bindings and the fuzzers share them.

pub mod blink1;
pub mod tara;
