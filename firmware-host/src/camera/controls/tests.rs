#![allow(clippy::unwrap_used)]
use super::*;
use proptest::prelude::*;

fn control(id: u32, name: &str, minimum: i64, maximum: i64, step: u64) -> Control {
    Control {
        id,
        name: name.to_owned(),
        kind: ControlKind::Integer,
        minimum,
        maximum,
        step,
        default: minimum,
        value: Some(minimum),
        read_only: false,
        inactive: false,
        menu: Vec::new(),
        wide: false,
    }
}

/// Controls of a common camera as described by uvcvideo.
fn camera() -> Vec<Control> {
    let menu = [(1, "Manual Mode"), (3, "Aperture Priority Mode")];
    let menu = menu.map(|(index, name)| MenuItem { index, name: name.to_owned() }).to_vec();
    vec![
        Control { kind: ControlKind::Menu, menu, ..control(EXPOSURE_AUTO, "auto_exposure", 0, 3, 1) },
        control(EXPOSURE_ABSOLUTE, "exposure_time_absolute", 1, 5000, 1),
        control(GAIN, "gain", 0, 100, 1),
        Control {
            kind: ControlKind::Boolean,
            ..control(AUTO_WHITE_BALANCE, "white_balance_automatic", 0, 1, 1)
        },
        control(WHITE_BALANCE_TEMPERATURE, "white_balance_temperature", 2800, 6500, 10),
        control(1, "sharpness", 0, 6, 1),
    ]
}

fn planned(settings: &ControlSettings) -> Vec<(String, i64)> {
    let plan = settings.plan(&camera()).unwrap();
    plan.into_iter().map(|write| (write.control.name, write.value)).collect()
}

fn refusal(settings: &ControlSettings) -> String {
    settings.plan(&camera()).unwrap_err().to_string()
}

#[test]
fn automatic_modes_are_written_before_values() {
    let settings = ControlSettings {
        exposure_us: Some(8000.0),
        gain: Some(12),
        white_balance_k: Some(4600),
        other: BTreeMap::from([("sharpness".to_owned(), 2)]),
        ..ControlSettings::default()
    };
    let expected = [
        ("auto_exposure", 1),
        ("exposure_time_absolute", 80),
        ("gain", 12),
        ("white_balance_automatic", 0),
        ("white_balance_temperature", 4600),
        ("sharpness", 2),
    ];
    assert_eq!(planned(&settings), expected.map(|(name, value)| (name.to_owned(), value)));
    let auto = ControlSettings { auto_exposure: Some(true), ..ControlSettings::default() };
    assert_eq!(planned(&auto), [("auto_exposure".to_owned(), 3)]);
    assert!(planned(&ControlSettings::default()).is_empty());
}

#[test]
fn refusals_say_what_is_valid() {
    let exposure =
        |exposure_us| ControlSettings { exposure_us: Some(exposure_us), ..ControlSettings::default() };
    let valid = "valid is 100 to 500000 us in steps of 100 us";
    assert_eq!(refusal(&exposure(8050.0)), format!("exposure_us is 8050; {valid}"));
    assert_eq!(refusal(&exposure(2e6)), format!("exposure_us is 2000000; {valid}"));
    assert!(
        refusal(&exposure(f64::NAN)).starts_with("controls.exposure_us is NaN; valid is 100 to 10000000 us")
    );
    let kelvin = ControlSettings { white_balance_k: Some(4605), ..ControlSettings::default() };
    assert_eq!(refusal(&kelvin), "white_balance_k is 4605; valid is 2800 to 6500 in steps of 10");
    let other = |name: &str, value| ControlSettings {
        other: BTreeMap::from([(name.to_owned(), value)]),
        ..ControlSettings::default()
    };
    let unknown = refusal(&other("sharpnes", 1));
    assert!(unknown.starts_with("the camera has no control sharpnes; it has: auto_exposure, "), "{unknown}");
    assert_eq!(
        refusal(&other("auto_exposure", 2)),
        "auto_exposure is 2; valid is 1 (Manual Mode), 3 (Aperture Priority Mode)"
    );
    let both = ControlSettings { auto_exposure: Some(true), ..exposure(8000.0) };
    assert!(refusal(&both).contains("valid is false, or no exposure_us"));
}

#[test]
fn later_wishes_win() {
    let mut settings =
        ControlSettings { exposure_us: Some(8000.0), gain: Some(3), ..ControlSettings::default() };
    settings.merge(&ControlSettings { auto_exposure: Some(true), ..ControlSettings::default() });
    assert_eq!((settings.exposure_us, settings.auto_exposure, settings.gain), (None, Some(true), Some(3)));
    settings.merge(&ControlSettings { exposure_us: Some(500.0), ..ControlSettings::default() });
    assert_eq!((settings.exposure_us, settings.auto_exposure), (Some(500.0), None));
}

#[test]
fn names_are_those_of_v4l2_ctl() {
    for (text, name) in [
        ("Exposure Time, Absolute", "exposure_time_absolute"),
        ("White Balance, Automatic", "white_balance_automatic"),
        ("Exposure (Absolute)", "exposure_absolute"),
        ("Gain", "gain"),
    ] {
        assert_eq!(control_name(text), name);
    }
}

proptest! {
    /// A value passes exactly if it is one of minimum, minimum + step, .. maximum.
    #[test]
    fn values_are_checked_against_range_and_step(
        minimum in -1000i64..1000, steps in 0u64..50, step in 1u64..30, value in -3000i64..4000
    ) {
        let maximum = minimum + (steps * step) as i64;
        let control = control(1, "gain", minimum, maximum, step);
        let valid = (0..=steps).any(|n| minimum + (n * step) as i64 == value);
        prop_assert_eq!(control.check(value).is_ok(), valid);
    }
}
