//! The documentation of every setting is complete, correct and current. Unknown keys get suggestions.
#![allow(clippy::unwrap_used)]

mod extremes;

use gelstereo_core::params::Params;
use gelstereo_host::config::reference::{SettingDoc, reference_page, settings};
use gelstereo_host::config::{Config, ConfigError};
use gelstereo_sim::Scene;
use proptest::prelude::*;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// The default with its rig inline, as a recording keeps it.
fn whole() -> Config {
    Config { rig: Some(Scene::default_rig()), ..Config::default() }
}

fn table(config: &Config) -> Table {
    Table::try_from(config).unwrap()
}

/// Paths of all values that are not tables; elements of lists as `path[0]`.
fn leaves(table: &Table) -> Vec<(String, Value)> {
    fn walk(path: &str, value: &Value, found: &mut Vec<(String, Value)>) {
        match value {
            Value::Table(table) => {
                table.iter().for_each(|(key, value)| walk(&format!("{path}.{key}"), value, found))
            }
            Value::Array(items) if !items.is_empty() => {
                items.iter().enumerate().for_each(|(k, item)| walk(&format!("{path}[{k}]"), item, found));
            }
            value => found.push((path[1..].to_owned(), value.clone())),
        }
    }
    let mut found = Vec::new();
    walk("", &Value::Table(table.clone()), &mut found);
    found
}

/// Puts a value in the place of a leaf.
fn replace(table: &mut Table, path: &str, value: Value) {
    let mut parts = path.split('.').peekable();
    let mut table = table;
    while let Some(part) = parts.next() {
        let (key, indices) = part.split_once('[').map_or((part, None), |(key, rest)| (key, Some(rest)));
        let mut slot = table.get_mut(key).unwrap();
        for index in indices.into_iter().flat_map(|rest| rest.trim_end_matches(']').split("][")) {
            slot = &mut slot.as_array_mut().unwrap()[index.parse::<usize>().unwrap()];
        }
        if parts.peek().is_none() {
            *slot = value;
            return;
        }
        table = slot.as_table_mut().unwrap();
    }
}

/// The key of a leaf without the indices of lists.
fn key(path: &str) -> String {
    path.split('[').next().unwrap().to_owned()
}

/// What is said of each setting; a key that several kinds of a table have is said of each.
fn documented() -> BTreeMap<String, Vec<SettingDoc>> {
    let mut found: BTreeMap<String, Vec<SettingDoc>> = BTreeMap::new();
    for setting in settings() {
        found.entry(setting.path.clone()).or_default().push(setting);
    }
    found
}

/// A scene's effects beyond those of the default are on the simulator's page, the rig is written by a
/// program.
fn is_written_by_hand(path: &str) -> bool {
    let table = table(&Config::default());
    let own = leaves(&table).iter().any(|(leaf, _)| key(leaf) == path);
    own || !(path.starts_with("rig.") || path.starts_with("simulated.effects."))
}

#[test]
fn every_setting_says_what_it_means_and_when_to_change_it() {
    let documented = documented();
    for (path, _) in leaves(&table(&Config::default())) {
        assert!(documented.contains_key(&key(&path)), "{path} has no comment");
    }
    let mut lacking = Vec::new();
    for setting in documented.values().flatten().filter(|s| !s.table && is_written_by_hand(&s.path)) {
        let tag = setting.path.ends_with(".kind");
        if setting.text.is_empty() || !(tag || setting.says_when()) {
            lacking.push(format!("{} ({:?}): {}", setting.path, setting.kind, setting.text));
        }
    }
    assert!(
        lacking.is_empty(),
        "the doc comment of each setting has a sentence that says when to change it (\"Raise it when ..\", \
         \"Change it to ..\", \"Set it ..\"):\n{}",
        lacking.join("\n")
    );
}

#[test]
fn every_number_states_its_valid_range() {
    let documented = documented();
    let lacking: Vec<String> = leaves(&table(&Config::default()))
        .into_iter()
        .filter(|(_, value)| value.is_float() || value.is_integer())
        .map(|(path, _)| key(&path))
        .filter(|path| documented[path].iter().any(|setting| setting.valid.is_none()))
        .collect();
    assert!(lacking.is_empty(), "\"Valid: LOW to HIGH unit\" is missing: {lacking:?}");
}

/// The printed default has a comment before every setting, and none about a setting that does not exist.
#[test]
fn the_printed_default_has_a_comment_on_every_line() {
    let text = Config::default().to_commented_toml().unwrap();
    let documented = documented();
    let (mut table, mut settings_seen, mut before) = (String::new(), 0, "");
    for line in text.lines() {
        if let Some(name) = line.strip_prefix('[') {
            table = format!("{}.", name.trim_end_matches(']'));
        } else if let Some((name, _)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) {
            assert!(before.starts_with('#'), "no comment before {line:?}");
            assert!(documented.contains_key(&format!("{table}{name}")), "{table}{name}");
            settings_seen += 1;
        }
        assert!(line.chars().count() <= 102, "{line}");
        before = line;
    }
    let keys: std::collections::BTreeSet<String> =
        leaves(&self::table(&Config::default())).iter().map(|(path, _)| key(path)).collect();
    assert_eq!(settings_seen, keys.len());
}

/// A doc comment's default is the default.
#[test]
fn stated_defaults_are_the_defaults() {
    // The pipeline's types state the paper's defaults; presets differ from them.
    let config = Config { params: Params::default(), ..Config::default() };
    let mut compared = 0;
    for (path, value) in leaves(&table(&config)) {
        let Some(setting) = documented().get(&path).and_then(|all| all.first().cloned()) else { continue };
        let Some(stated) = setting.stated_default() else { continue };
        let agrees = match value {
            Value::Float(value) if stated == "1/3" => value == 1.0 / 3.0,
            Value::Float(value) => stated.parse() == Ok(value),
            Value::Integer(value) => stated.parse() == Ok(value),
            Value::Boolean(value) => stated.parse() == Ok(value),
            Value::String(value) => stated == value,
            _ => true,
        };
        assert!(agrees, "{path}: its doc comment says {stated}");
        compared += 1;
    }
    assert!(compared > 60, "{compared} defaults compared");
}

/// What a configuration with this leaf comes to; whether the error names the leaf.
fn verdict(path: &str, value: Value) -> Result<(), String> {
    let mut table = table(&whole());
    replace(&mut table, path, value);
    let text = toml::to_string(&table).unwrap();
    match Config::parse(&text, "changed").and_then(|config| config.validate()) {
        Ok(()) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

fn names(message: &str, path: &str) -> bool {
    let key = key(path);
    let (table, name) = key.rsplit_once('.').unwrap_or(("", &key));
    // A pose is refused as a whole, in words; a rig's cameras are named by their fields.
    let word = if name.starts_with("rotation") { "the rotation" } else { "the translation" };
    let in_pose = message.contains(word) && message.contains(table);
    let in_rig = table.starts_with("rig.") && (message.contains(name) || message.starts_with("rig: "));
    // A number of the wrong kind is shown in its line.
    let in_line = message.contains("TOML parse error") && message.contains(&format!("{name} = "));
    // A scene names its own settings, as in "valid is below gel.bright_level".
    let in_scene = key.strip_prefix("simulated.").is_some_and(|key| message.contains(key));
    message.contains(&key) || in_scene || in_pose || in_rig || in_line
}

/// Each number in turn is replaced by what is not a number, by what is far too large, and by what its comment
/// says is just outside: each is refused with an error that names it.
#[test]
fn no_number_outside_its_range_is_accepted() {
    let documented = documented();
    let whole = table(&whole());
    let mut tried = 0;
    for (path, value) in leaves(&whole) {
        let (is_float, is_integer) = (value.is_float(), value.is_integer());
        if !is_float && !is_integer {
            continue;
        }
        let mut wrong: Vec<Value> =
            [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300].map(Value::Float).to_vec();
        let range = documented.get(&key(&path)).and_then(|all| all.iter().find_map(|s| s.valid));
        if let Some(range) = range {
            let beyond = |x: f64, sign: f64| x + sign * (1e-3 * x.abs()).max(1e-9);
            if is_float {
                wrong.push(Value::Float(beyond(range.low, -1.0)));
                wrong.push(Value::Float(beyond(range.high, 1.0)));
            } else {
                wrong.push(Value::Integer(range.low as i64 - 1));
                wrong.extend((range.high < 9e18).then(|| Value::Integer(range.high as i64 + 1)));
            }
            for probe in [-1.0, 0.0, 1e9, -1e9] {
                if !range.contains(probe) {
                    wrong.push(if is_float { Value::Float(probe) } else { Value::Integer(probe as i64) });
                }
            }
        }
        for value in wrong {
            tried += 1;
            match verdict(&path, value.clone()) {
                Ok(()) => panic!("{path} = {value} is accepted"),
                Err(message) => assert!(names(&message, &path), "{path} = {value}: {message}"),
            }
        }
    }
    assert!(tried > 500, "{tried}");
}

/// What a comment calls valid is accepted, unless another setting forbids it, and then the error says so.
#[test]
fn numbers_within_their_range_are_accepted_or_contradict_another_one() {
    let documented = documented();
    let (mut accepted, mut refused) = (0, Vec::new());
    for (path, value) in leaves(&table(&Config::default())) {
        let range = documented[&key(&path)].iter().find_map(|s| s.valid);
        let Some(range) = range.filter(|_| value.is_float() || value.is_integer()) else { continue };
        for number in [range.low, range.high] {
            let number = if value.is_float() { Value::Float(number) } else { Value::Integer(number as i64) };
            match verdict(&path, number.clone()) {
                Ok(()) => accepted += 1,
                Err(message) => {
                    assert!(
                        names(&message, &path) || message.contains("valid"),
                        "{path} = {number}: {message}"
                    );
                    refused.push(format!("{path} = {number}: {message}"));
                }
            }
        }
    }
    println!("{}", refused.join("\n"));
    assert!(accepted > 150, "{accepted} accepted; refused:\n{}", refused.join("\n"));
}

/// Found from outside: each of these passed `check`; the first wrote 2 GB in 68 s.
#[test]
fn accepted_nonsense_is_refused() {
    let cases = [
        ("params.detect.channel", Value::String("blue".to_owned())),
        ("mount.t_pad_sensor.translation_mm[0]", Value::Float(4e9)),
        ("mount.kinematics.reach_mm", Value::Float(4e9)),
        ("recording.path", Value::String(String::new())),
        ("params.lattice.pitch_mm", Value::Float(5.0)),
        ("mount.kinematics.max_theta_rad", Value::Float(9e18)),
        ("params.register.filterreg.max_sigma_mm", Value::Float(1e300)),
    ];
    for (path, value) in cases {
        let message = verdict(path, value).unwrap_err();
        assert!(names(&message, path), "{path}: {message}");
    }
    let mut config = whole();
    let layers = "normal = { x = 0, y = 0, z = 1 }\ngap_mm = 1e308\nplates = []\ngel_index = 1.4";
    if let Ok(layers) = toml::from_str(layers) {
        config.rig.as_mut().unwrap().layers = Some(layers);
    } else {
        let layers = "normal = [0.0, 0.0, 1.0]\ngap_mm = 1e308\nplates = []\ngel_index = 1.4";
        config.rig.as_mut().unwrap().layers = Some(toml::from_str(layers).unwrap());
    }
    let message = config.validate().unwrap_err().to_string();
    assert!(message.contains("layers.gap_mm is 1"), "{message}");
}

/// A camera's views must be as large as the rig's, and come before the task gives up.
#[test]
fn a_camera_agrees_with_rig_and_task() {
    let error = |text: &str| {
        let text = format!("[source]\nkind = \"camera\"\ndevice = \"serial:1\"\n{text}");
        let mut config = Config::parse(&text, "cell.toml").unwrap();
        config.rig = Some(Scene::default_rig());
        config.validate().map_err(|error| error.to_string())
    };
    assert_eq!(error("size_px = [1280, 480]"), Ok(()));
    let size = error("size_px = [2560, 720]").unwrap_err();
    assert_eq!(
        size,
        "source.size_px is [2560, 720], which gives views of 1280 x 720 px, but the rig is of 640 x 480 px; \
         calibrate at this size, or take images at the rig's"
    );
    let wait = error("frame_rate_hz = 1\n[task]\nframe_timeout_s = 1.5").unwrap_err();
    assert!(wait.starts_with("task.frame_timeout_s is 1.5 s, but source.frame_rate_hz is 1 Hz"), "{wait}");
}

#[test]
fn ways_that_take_longer_than_a_stage_may_are_refused() {
    let message = verdict("task.move_speed_mm_s", Value::Float(0.01)).unwrap_err();
    assert!(message.starts_with("task.move_speed_mm_s is too slow: the way takes "), "{message}");
    assert!(verdict("task.insertion_speed_mm_s", Value::Float(0.1)).is_err());
}

#[test]
fn a_key_that_does_not_exist_is_told_from_the_one_that_was_meant() {
    let cases = [
        (
            "[task]\ninsertion_depth = 3",
            "line 2: there is no setting `task.insertion_depth`; did you mean \
         `task.insertion_depth_mm`?",
        ),
        ("[task]\ninsertoin_depth_mm = 3", "did you mean `task.insertion_depth_mm`?"),
        ("[tasks]\nlift_mm = 3", "line 1: there is no setting `tasks`; did you mean `task`?"),
        ("[params.register]\nransac_hypotheses = 9", "did you mean `params.register.ransac_icp.hypotheses`?"),
        ("[params.register]\nmethod = \"icp_plane\"", "did you mean `surface_close`?"),
        ("[params.detect]\ncentre = \"band\"", "did you mean `soft_threshold`?"),
        ("[params.detect]\ncentre = \"matched\"", "did you mean `fit`?"),
        ("[params.register]\nmethod = \"surface_track\"", "did you mean `surface_close`?"),
        ("[params.contact]\nsaliency = \"pressure_quick\"", "did you mean `pressure`?"),
        ("[params]\npitch_mm = 1", "did you mean `params.lattice.pitch_mm`?"),
        ("[params.detect]\npitch_mm = 1", "did you mean `params.lattice.pitch_mm`?"),
        ("[params.detect.fit]\nblur = 1", "did you mean `params.detect.fit.blur_px`?"),
        ("[mount.kinematics]\nkind = \"parallel\"\nreach = 1", "did you mean `mount.kinematics.reach_mm`?"),
        (
            "[mount.kinematics]\nkind = \"parallel\"\na_mm = 1",
            "`mount.kinematics.a_mm` belongs to kind \"parallelogram\", \
         but this table's kind is \"parallel\"",
        ),
        (
            "path = \"x.mcap\"",
            "line 1: there is no setting `path`; did you mean `source.path` or `recording.path`",
        ),
        ("simulated = { gel = { row = 3 } }", "did you mean `simulated.gel.rows`?"),
        (
            "[simulated.effects.sensor_noise]\nsigma = 1",
            "did you mean `simulated.effects.sensor_noise.sigma_levels`?",
        ),
        ("[task.goal_pose]\nposition = [0, 0, 0]", "did you mean `task.goal_pose.position_mm`?"),
        (
            "[params.detect]\ncentre = \"soft_treshold\"",
            "line 2: params.detect.centre is \"soft_treshold\"; did you mean `soft_threshold`?",
        ),
        ("part = { shape = { kind = \"cylindre\" } }", "did you mean `cylinder`?"),
        ("xyzzy = 1", "valid is one of preset, rig_file, sensor_file, compliance_file, source, "),
    ];
    for (text, words) in cases {
        let message = Config::parse(text, "cell.toml").unwrap_err().to_string();
        assert!(message.contains(words), "{text}\n  {message}\n  lacks {words}");
    }
}

#[test]
fn a_rig_file_has_the_same_checks() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = Table::try_from(Scene::default_rig()).unwrap();
    rig["left"].as_table_mut().unwrap().insert("fx".to_owned(), Value::Float(1.0));
    std::fs::write(folder.path().join("rig.toml"), toml::to_string(&rig).unwrap()).unwrap();
    std::fs::write(folder.path().join("cell.toml"), "rig_file = \"rig.toml\"").unwrap();
    let message = Config::load(&folder.path().join("cell.toml")).unwrap_err().to_string();
    assert!(message.contains("there is no setting `left.fx`; did you mean `left.fx_px`?"), "{message}");
}

proptest! {
    /// One slip of the finger in any key is told, and the key that was meant is among the suggestions.
    #[test]
    fn a_slip_in_any_key_is_corrected(
        which in any::<prop::sample::Index>(), place in any::<prop::sample::Index>(), slip in 0..3,
        letter in "[a-z]",
    ) {
        let all = leaves(&table(&Config::default()));
        let path = key(&all[which.index(all.len())].0);
        let (prefix, name) = path.rsplit_once('.').unwrap_or(("", &path));
        prop_assume!(name.len() >= 4);
        let k = place.index(name.len() - 1);
        let mut typed: Vec<char> = name.chars().collect();
        match slip {
            0 => {
                typed.remove(k);
            }
            1 => typed.swap(k, k + 1),
            _ => typed.insert(k, letter.chars().next().unwrap()),
        }
        let typed: String = typed.into_iter().collect();
        let known = settings().iter().any(|s| s.path == format!("{prefix}.{typed}"));
        prop_assume!(typed != name && !known);
        let text =
            if prefix.is_empty() { format!("{typed} = 1") } else { format!("[{prefix}]\n{typed} = 1") };
        match Config::parse(&text, "cell.toml") {
            Err(ConfigError::Unknown { unknown, .. }) => {
                prop_assert_eq!(unknown.line, if prefix.is_empty() { 1 } else { 2 });
                prop_assert!(unknown.suggestions.contains(&path), "{}: {:?}", typed, unknown.suggestions);
            }
            other => prop_assert!(false, "{text}: {other:?}"),
        }
    }

    /// Text that is no configuration is an error in words, never a panic.
    #[test]
    fn any_text_is_read_or_refused(text in "(\\[?[a-z_.]{0,12}\\]? ?=? ?[0-9a-z\"{}\\[\\]]{0,8}\n?){0,6}") {
        if let Err(error) = Config::parse(&text, "text").and_then(|config| config.validate()) {
            prop_assert!(!error.to_string().is_empty());
        }
    }
}

const BEGIN: &str = "<!-- begin reference -->\n";
const END: &str = "<!-- end reference -->";

/// The page's reference is what the doc comments say. GELSTEREO_UPDATE=1 writes it.
#[test]
fn the_page_is_current() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/configuration.md");
    let page = std::fs::read_to_string(path).unwrap();
    let (before, rest) = page.split_once(BEGIN).unwrap();
    let (found, after) = rest.split_once(END).unwrap();
    let expected = format!("\n{}", reference_page().unwrap());
    if std::env::var_os("GELSTEREO_UPDATE").is_some() {
        std::fs::write(path, format!("{before}{BEGIN}{expected}{END}{after}")).unwrap();
    } else {
        assert!(
            found == expected,
            "docs/configuration.md is not current: run this test with GELSTEREO_UPDATE=1"
        );
    }
}

/// The examples say of each setting what it means, name only what exists, and are valid once there is a rig.
#[test]
fn examples_are_commented_and_valid() {
    let mut examples = 0;
    for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/configs")).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let mut before = "";
        for line in text.lines() {
            let is_setting = line.contains(" = ") && !line.starts_with('#') && !line.starts_with("kind = ");
            assert!(
                !is_setting || before.starts_with("# "),
                "{}: no comment before {line:?}",
                path.display()
            );
            assert!(line.chars().count() <= 112, "{}: {line}", path.display());
            before = line;
        }
        let mut config = Config::parse(&text, &path.display().to_string()).unwrap();
        config.rig = Some(Scene::default_rig());
        config.validate().unwrap();
        examples += 1;
    }
    assert!(examples >= 4);
}
