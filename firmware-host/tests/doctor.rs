//! Reading sysfs, permissions, and the doctor on this computer, whatever is connected to it.
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

use gelstereo_host::doctor::{Permissions, Roots, SerialPort, UdevMatch, UsbIdentity, advise, serial_ports};
use proptest::prelude::*;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

fn write(path: PathBuf, text: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

fn link(target: &Path, link: PathBuf) {
    fs::create_dir_all(link.parent().unwrap()).unwrap();
    symlink(target, link).unwrap();
}

fn roots(folder: &Path) -> Roots {
    let at = |name: &str| folder.join(name);
    Roots { sys: at("sys"), dev: at("dev"), etc: at("etc"), run: at("run") }
}

/// A USB device with one interface at the port of that name.
fn usb(folder: &Path, port: &str, ids: [&str; 2], serial: Option<&str>) -> PathBuf {
    let device = folder.join("sys/devices/pci0000:00/usb1").join(port);
    write(device.join("idVendor"), &format!("{}\n", ids[0]));
    write(device.join("idProduct"), &format!("{}\n", ids[1]));
    if let Some(serial) = serial {
        write(device.join("serial"), &format!("{serial}\n"));
    }
    let interface = device.join(format!("{port}:1.0"));
    fs::create_dir_all(&interface).unwrap();
    interface
}

/// The tree as Linux 6 lays it out for an FTDI adapter, a CDC-ACM device, a standard port, a phantom one and
/// a console.
fn tree(folder: &Path) {
    let class = folder.join("sys/class/tty");
    let drivers = folder.join("sys/bus/drivers");
    let ftdi = usb(folder, "1-2", ["0403", "6015"], Some("DK0A1B2C")).join("ttyUSB10");
    write(ftdi.join("latency_timer"), "16\n");
    link(&drivers.join("ftdi_sio"), ftdi.join("driver"));
    link(&ftdi, class.join("ttyUSB10/device"));
    let acm = usb(folder, "1-3", ["16d0", "117e"], None);
    link(&drivers.join("cdc_acm"), acm.join("driver"));
    link(&acm, class.join("ttyACM2/device"));
    for (name, kind) in [("ttyS0", "4"), ("ttyS1", "0")] {
        let port = folder.join("sys/devices/pnp0").join(name);
        link(&drivers.join("serial"), port.join("driver"));
        link(&port, class.join(name).join("device"));
        write(class.join(name).join("type"), kind);
    }
    write(class.join("tty0/dev"), "4:0");
    link(Path::new("../../ttyUSB10"), folder.join("dev/serial/by-id/usb-FTDI_DK0A1B2C-if00-port0"));
}

#[test]
fn serial_ports_are_those_with_hardware_behind_them() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(serial_ports(&roots(folder.path())), []);
    tree(folder.path());
    let dev = folder.path().join("dev");
    let identity = |vendor_id: &str, product_id: &str, serial: Option<&str>| UsbIdentity {
        vendor_id: vendor_id.to_owned(),
        product_id: product_id.to_owned(),
        serial: serial.map(str::to_owned),
        ..UsbIdentity::default()
    };
    let expected = [
        SerialPort {
            path: dev.join("ttyACM2"),
            by_id: None,
            driver: "cdc_acm".to_owned(),
            usb: Some(identity("16d0", "117e", None)),
            latency_timer_ms: None,
        },
        SerialPort {
            path: dev.join("ttyS0"),
            by_id: None,
            driver: "serial".to_owned(),
            usb: None,
            latency_timer_ms: None,
        },
        SerialPort {
            path: dev.join("ttyUSB10"),
            by_id: Some(dev.join("serial/by-id/usb-FTDI_DK0A1B2C-if00-port0")),
            driver: "ftdi_sio".to_owned(),
            usb: Some(identity("0403", "6015", Some("DK0A1B2C"))),
            latency_timer_ms: Some(16),
        },
    ];
    assert_eq!(serial_ports(&roots(folder.path())), expected);
    let text = expected[2].to_string();
    assert!(text.ends_with("(ftdi_sio, 0403:6015 serial DK0A1B2C, latency timer 16 ms)"), "{text}");
}

const HIDRAW: UdevMatch<'_> = UdevMatch { subsystem: "hidraw", usb: Some(("2560", "c114")) };

#[test]
fn whoever_lacks_access_learns_the_group_or_the_rule() {
    let node = Path::new("/dev/hidraw3");
    let dialout = advise(Permissions { mode: 0o20660, gid: 20 }, Some("dialout"), HIDRAW, node);
    assert!(dialout.contains("sudo usermod -aG dialout $USER"), "{dialout}");
    let rule = advise(Permissions { mode: 0o20600, gid: 0 }, Some("root"), HIDRAW, node);
    let expected = "SUBSYSTEM==\"hidraw\", ATTRS{idVendor}==\"2560\", ATTRS{idProduct}==\"c114\", \
                    MODE=\"0660\", TAG+=\"uaccess\"";
    assert!(rule.ends_with(expected), "{rule}");
    let port = UdevMatch { subsystem: "tty", usb: None };
    let rule = advise(Permissions { mode: 0o20600, gid: 0 }, None, port, Path::new("/dev/ttyS0"));
    assert!(
        rule.ends_with("SUBSYSTEM==\"tty\", KERNEL==\"ttyS0\", MODE=\"0660\", TAG+=\"uaccess\""),
        "{rule}"
    );
}

proptest! {
    /// No advice puts anybody into root's group, and none names a group that has no access.
    #[test]
    fn advice_gives_access(mode in 0u32..0o1000, gid in 0u32..3, named in any::<bool>()) {
        let group = named.then_some("video");
        let advice = advise(Permissions { mode, gid }, group, HIDRAW, Path::new("/dev/hidraw0"));
        let by_group = advice.contains("usermod");
        prop_assert_eq!(by_group, named && gid != 0 && mode & 0o060 == 0o060);
        prop_assert!(by_group || advice.contains("SUBSYSTEM"));
    }
}

fn doctor(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gelstereo-host"));
    let result = command.current_dir(folder).arg("doctor").args(arguments).output().unwrap();
    let text =
        [result.stdout, result.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    (result.status.code(), text)
}

/// The default needs no hardware: `run` would start on any computer.
#[test]
fn the_doctor_says_that_the_simulated_job_would_start() {
    let folder = tempfile::tempdir().unwrap();
    let (code, text) = doctor(folder.path(), &[]);
    assert_eq!(code, Some(0), "{text}");
    for subject in
        ["camera", "serial port", "HID device", "disk", "clock", "wall clock", "processor", "recording"]
    {
        assert!(
            text.lines().any(|line| line[7..].trim_start().starts_with(subject) && line.len() > 22),
            "{text}"
        );
    }
    assert!(text.contains("`gelstereo-host run` would start: 0 wrong, "), "{text}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "it leaves nothing behind");

    let (code, text) = doctor(folder.path(), &["--json"]);
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(code == Some(0) && report["run_would_start"] == true);
    assert!(report["findings"].as_array().unwrap().len() > 8);
    assert!(report["connected"]["serial_ports"].is_array());
}

#[test]
fn the_doctor_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let rig = toml::to_string(&gelstereo_sim::Scene::default_rig()).unwrap();
    fs::write(folder.path().join("rig.toml"), rig).unwrap();
    let camera = "rig_file = \"rig.toml\"\n[source]\nkind = \"camera\"\ndevice = \"serial:NOT-THERE\"\n\
                  [light]\nkind = \"blink1\"\n";
    fs::write(folder.path().join("cell.toml"), camera).unwrap();
    let (code, text) = doctor(folder.path(), &["--config", "cell.toml"]);
    assert_eq!(code, Some(1), "{text}");
    for words in [
        "there is no camera serial:NOT-THERE",
        "needs a blink(1): there is no HID device 27b8:01ed",
        "would not start",
    ] {
        assert!(text.contains(words), "{text}\nlacks {words}");
    }
    let (code, text) = doctor(folder.path(), &["--config", "missing.toml"]);
    assert!(code == Some(2) && text.contains("cannot read missing.toml"), "{text}");
}
