//! Cameras by Video4Linux2: capture, decoding to luma, controls.
