//! HID devices through Linux's hidraw: the control interface of cameras, and lights. Lights with a
//! kernel driver are switched through the LED class.
//!
//! On other systems listing finds nothing and opening returns [`HidError::Unsupported`].

mod blink1;
#[cfg(target_os = "linux")]
mod device;
mod error;
mod led;
mod list;
#[cfg(target_os = "linux")]
mod report_ioctl;
mod tara;
#[cfg(not(target_os = "linux"))]
mod unsupported;

pub use blink1::Blink1Light;
#[cfg(target_os = "linux")]
pub use device::HidDevice;
pub use error::{HidError, udev_rule};
pub use led::{KernelLed, kernel_leds};
pub use list::{HidInfo, HidSelector, list};
pub use tara::TaraControl;
#[cfg(not(target_os = "linux"))]
pub use unsupported::HidDevice;
