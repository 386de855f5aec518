//! HID devices by hidraw.
