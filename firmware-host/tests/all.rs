//! All tests in one binary but for the long run, which counts the memory and the file handles of its own
//! process.
mod quick_world;

mod binary;
mod camera;
mod codec_grippers;
mod config;
mod doctor;
mod edge;
mod faults;
mod folder;
mod frame_stream;
mod hid_codec;
mod jpeg;
mod recording;
mod reference;
mod replay;
mod report;
mod robot_bridge;
mod second_look;
mod sense;
mod stream;
mod task;
mod teach;
mod triggers;
