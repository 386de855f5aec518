//! Named values with their units.

use maud::{Markup, html};
use serde_json::Value;

/// Unit suffixes of figure names, and their notation.
const UNITS: [(&str, &str); 12] = [
    ("_mm_s", "mm/s"),
    ("_mrad", "mrad"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_px", "px"),
    ("_mm", "mm"),
    ("_us", "us"),
    ("_ms", "ms"),
    ("_ns", "ns"),
    ("_hz", "Hz"),
    ("_s", "s"),
    ("_n", "N"),
];
/// A figure's name without its unit, and the unit.
struct Label {
    name: String,
    unit: &'static str,
}

impl Label {
    fn of(name: &str) -> Self {
        let found = UNITS.iter().find_map(|(ending, unit)| Some((name.strip_suffix(ending)?, *unit)));
        let (stem, unit) = found.unwrap_or((name, ""));
        Self { name: stem.replace('_', " "), unit }
    }
}

/// Integers without decimals, others with three, or five below 0.1.
fn number(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e15 {
        format!("{value:.0}")
    } else if value.abs() >= 0.1 {
        format!("{value:.3}")
    } else {
        format!("{value:.5}")
    }
}

/// A figure in a line of text.
pub(super) fn named(name: &str, value: f64) -> Markup {
    let label = Label::of(name);
    html! {
        span {
            (label.name) " " (number(value))
            @if !label.unit.is_empty() { " " span class="unit" { (label.unit) } }
        }
    }
}

/// A text, or named values of any depth, one per line.
pub(super) fn values(value: &Value) -> Markup {
    if let Value::String(text) = value {
        return html! { p { (text) } };
    }
    let mut lines = Vec::new();
    flatten(&mut lines, String::new(), value);
    html! {
        div class="wide" {
            table {
                thead {
                    tr {
                        th scope="col" { "Name" }
                        th scope="col" class="number" { "Value" }
                        th scope="col" { "Unit" }
                    }
                }
                tbody {
                    @for line in &lines {
                        @let label = Label::of(&line.name);
                        tr {
                            th scope="row" { (label.name) }
                            td class="number" { (line.value) }
                            td class="unit" { (label.unit) }
                        }
                    }
                }
            }
        }
    }
}

struct Line {
    name: String,
    value: String,
}

fn flatten(lines: &mut Vec<Line>, name: String, value: &Value) {
    let below = |key: &str| if name.is_empty() { key.to_owned() } else { format!("{name}, {key}") };
    match value {
        Value::Null => {}
        Value::Object(fields) => fields.iter().for_each(|(key, value)| flatten(lines, below(key), value)),
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                flatten(lines, below(&(index + 1).to_string()), item);
            }
        }
        Value::Bool(true) => lines.push(Line { name, value: "yes".to_owned() }),
        Value::Bool(false) => lines.push(Line { name, value: "no".to_owned() }),
        Value::Number(found) => {
            let value = found.as_f64().map_or_else(|| found.to_string(), number);
            lines.push(Line { name, value });
        }
        Value::String(text) => lines.push(Line { name, value: text.clone() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All other contents of the report appear on the page, with their units.
    #[test]
    fn values_of_any_depth_stand_on_lines_of_their_own() {
        let value =
            serde_json::json!({ "insertion": { "frame_to_wire_p99_ms": 4.25, "acts": [true, null] } });
        let mut lines = Vec::new();
        flatten(&mut lines, String::new(), &value);
        let mut found: Vec<String> = lines
            .iter()
            .map(|line| {
                let label = Label::of(&line.name);
                format!("{}={} {}", label.name, line.value, label.unit)
            })
            .collect();
        found.sort();
        assert_eq!(found, ["insertion, acts, 1=yes ", "insertion, frame to wire p99=4.250 ms"]);
    }
}
