//! Trees of settings: conversion between TOML text and Python dictionaries.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PyString, PyTuple, PyType};
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// Parses a value from TOML text; the message names the line.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    toml::from_str(text).map_err(|error| {
        let named = named(text, &error, true);
        let is_path = text.trim_end().ends_with(".toml") && !text.contains('\n');
        if is_path { format!("{named} (this is the name of a file: use load())") } else { named }
    })
}

/// The parser's message, with its line.
fn named(text: &str, error: &toml::de::Error, numbered: bool) -> String {
    let message = error.message();
    let Some((before, after)) = error.span().and_then(|span| text.split_at_checked(span.start)) else {
        return message.to_owned();
    };
    let start = before.rsplit('\n').next().unwrap_or_default();
    let line = format!("{start}{}", after.lines().next().unwrap_or_default());
    let line = short(line.trim());
    match numbered {
        true => format!("line {}, `{}`: {message}", before.matches('\n').count() + 1, line),
        false => format!("`{line}`: {message}"),
    }
}

/// Formats a value as TOML text.
pub fn to_toml<T: Serialize>(value: &T) -> Result<String, String> {
    toml::to_string(value).map_err(|error| error.to_string())
}

/// Replaces some settings of a value, by nested dictionaries or dotted names; None removes a setting,
/// which then has its default.
pub fn replace<T: Serialize + DeserializeOwned>(
    value: &T,
    changes: &Bound<'_, PyMapping>,
) -> Result<T, String> {
    let mut tree = Table::try_from(value).map_err(|error| error.to_string())?;
    merge(&mut tree, changes, DEEPEST)?;
    from_tree(&tree)
}

/// Builds a value from nested dictionaries.
pub fn from_mapping<T: DeserializeOwned>(mapping: &Bound<'_, PyMapping>) -> Result<T, String> {
    let mut tree = Table::new();
    merge(&mut tree, mapping, DEEPEST)?;
    from_tree(&tree)
}

/// Goes through text, because only the parser's errors name the setting.
fn from_tree<T: DeserializeOwned>(tree: &Table) -> Result<T, String> {
    let text = to_toml(tree)?;
    toml::from_str(&text).map_err(|error| named(&text, &error, false))
}

/// Largest nesting depth of settings; guards against dictionaries that contain themselves.
const DEEPEST: usize = 32;

fn deeper(left: usize) -> Result<usize, String> {
    left.checked_sub(1)
        .ok_or_else(|| format!("settings are nested more than {DEEPEST} deep; valid is three or four"))
}

/// Merges `changes` into `tree`; unknown names are kept, to be rejected by name on deserialisation.
fn merge(tree: &mut Table, changes: &Bound<'_, PyMapping>, depth: usize) -> Result<(), String> {
    let depth = deeper(depth)?;
    for item in changes.items().map_err(text)?.iter() {
        let (name, change): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract().map_err(text)?;
        let Ok(name) = name.extract::<String>() else {
            return Err(format!("a setting is named {}; valid is text", shown(&name)));
        };
        match name.split_once('.') {
            Some((first, rest)) => {
                let nested = PyDict::new(changes.py());
                nested.set_item(rest, change).map_err(text)?;
                merge_one(tree, first, nested.as_any(), depth)?;
            }
            None => merge_one(tree, &name, &change, depth)?,
        }
    }
    Ok(())
}

fn merge_one(tree: &mut Table, name: &str, change: &Bound<'_, PyAny>, depth: usize) -> Result<(), String> {
    if change.is_none() {
        tree.remove(name);
        return Ok(());
    }
    let Ok(mapping) = change.cast::<PyMapping>() else {
        tree.insert(name.to_owned(), value(change, depth).map_err(|what| format!("{name}: {what}"))?);
        return Ok(());
    };
    // A table with a `kind` is a new variant and shares no settings with the previous one.
    let fresh = mapping.contains("kind").map_err(text)? || !tree.get(name).is_some_and(Value::is_table);
    if fresh {
        tree.insert(name.to_owned(), Value::Table(Table::new()));
    }
    match tree.get_mut(name) {
        Some(Value::Table(branch)) => merge(branch, mapping, depth),
        _ => Ok(()),
    }
}

fn value(object: &Bound<'_, PyAny>, depth: usize) -> Result<Value, String> {
    let depth = deeper(depth)?;
    if object.is_instance_of::<PyBool>() {
        return object.extract().map(Value::Boolean).map_err(text);
    }
    if object.is_instance_of::<PyString>() {
        return object.extract().map(Value::String).map_err(text);
    }
    if object.is_instance_of::<PyFloat>() {
        return object.extract().map(Value::Float).map_err(text);
    }
    if object.is_instance_of::<PyInt>() {
        return object
            .extract()
            .map(Value::Integer)
            .map_err(|_| format!("{} does not fit into 64 bits; valid is a smaller number", shown(object)));
    }
    if let Ok(mapping) = object.cast::<PyMapping>() {
        let mut nested = Table::new();
        merge(&mut nested, mapping, depth)?;
        return Ok(Value::Table(nested));
    }
    if object.is_instance_of::<PyList>() || object.is_instance_of::<PyTuple>() {
        let items = object.try_iter().map_err(text)?.map(|item| value(&item.map_err(text)?, depth));
        return items.collect::<Result<_, _>>().map(Value::Array);
    }
    // Arrays and NumPy numbers convert themselves to Python objects.
    if object.hasattr("tolist").map_err(text)? {
        return value(&object.call_method0("tolist").map_err(text)?, depth);
    }
    let name = object.get_type().name().map_err(text)?;
    Err(format!("the setting is of type {name}; valid is a number, text, a list or a dictionary"))
}

fn text(error: PyErr) -> String {
    error.to_string()
}

/// Python's `repr`, cut to one line.
fn shown(object: &Bound<'_, PyAny>) -> String {
    object.repr().map_or_else(|_| "unprintable".into(), |repr| short(&repr.to_string_lossy()))
}

/// Cuts a text to the length allowed in a message.
fn short(line: &str) -> String {
    const MOST: usize = 60;
    match line.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}...", &line[..end]),
        None => line.to_owned(),
    }
}

/// Converts a value to nested dictionaries.
pub fn to_dict<'py, T: Serialize>(py: Python<'py>, value: &T) -> PyResult<Bound<'py, PyDict>> {
    let tree = Table::try_from(value).map_err(|e| crate::errors::Error::new_err(e.to_string()))?;
    dict(py, &tree)
}

/// TOML text as nested dictionaries; Python reads TOML only since 3.11.
///
/// Raises
/// ------
/// Error
///     If the text is not TOML; the message names the line.
#[pyfunction]
pub fn parse_toml<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyDict>> {
    dict(py, &from_toml(text).map_err(crate::errors::Error::new_err)?)
}

fn dict<'py>(py: Python<'py>, tree: &Table) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    for (name, value) in tree {
        out.set_item(name, python(py, value)?)?;
    }
    Ok(out)
}

fn python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        Value::Float(number) => PyFloat::new(py, *number).into_any(),
        Value::Boolean(flag) => PyBool::new(py, *flag).to_owned().into_any(),
        Value::Datetime(time) => PyString::new(py, &time.to_string()).into_any(),
        Value::Array(items) => {
            PyList::new(py, items.iter().map(|item| python(py, item)).collect::<PyResult<Vec<_>>>()?)?
                .into_any()
        }
        Value::Table(tree) => dict(py, tree)?.into_any(),
    })
}

// File and pickle support for all settings classes, based on their `from_toml` and `to_toml`.

/// Loads a value of the class from a TOML file; errors about the content name the file.
pub fn load<'py>(cls: &Bound<'py, PyType>, path: std::path::PathBuf) -> PyResult<Bound<'py, PyAny>> {
    let text = read(cls.py(), path.clone())?;
    cls.call_method1("from_toml", (text,)).map_err(|error| in_file(cls.py(), &error, &path))
}

/// Writes a value to a TOML file.
pub fn save<T>(value: &Bound<'_, T>, path: std::path::PathBuf) -> PyResult<()> {
    write(value.py(), path, toml_of(value)?)
}

/// Arguments for unpickling.
pub type Reduced<'py> = (Bound<'py, PyAny>, (String,));

/// Pickles a value as its TOML text.
pub fn reduce<'py, T>(value: &Bound<'py, T>) -> PyResult<Reduced<'py>> {
    Ok((value.as_any().get_type().getattr("from_toml")?, (toml_of(value)?,)))
}

fn toml_of<T>(value: &Bound<'_, T>) -> PyResult<String> {
    value.as_any().call_method0("to_toml")?.extract()
}

/// Reads a text file.
pub fn read(py: Python<'_>, path: std::path::PathBuf) -> PyResult<String> {
    py.detach(|| std::fs::read_to_string(&path)).map_err(|error| with_path(error, &path))
}

/// Reads a binary file.
pub fn read_bytes(py: Python<'_>, path: std::path::PathBuf) -> PyResult<Vec<u8>> {
    py.detach(|| std::fs::read(&path)).map_err(|error| with_path(error, &path))
}

/// Adds the file's name to an error about its content.
pub fn in_file(py: Python<'_>, error: &PyErr, path: &std::path::Path) -> PyErr {
    PyErr::from_type(error.get_type(py), format!("{}: {}", path.display(), error.value(py)))
}

/// Writes a file.
pub fn write(py: Python<'_>, path: std::path::PathBuf, content: impl AsRef<[u8]> + Sync) -> PyResult<()> {
    py.detach(|| std::fs::write(&path, content.as_ref())).map_err(|error| with_path(error, &path))
}

/// Converts an error as Python's own `open` does: the OSError subclass by number, with the file's name.
fn with_path(error: std::io::Error, path: &std::path::Path) -> PyErr {
    match error.raw_os_error() {
        Some(number) => {
            let text = error.to_string();
            let reason = text.split(" (os error").next().unwrap_or_default().to_owned();
            pyo3::exceptions::PyOSError::new_err((number, reason, path.display().to_string()))
        }
        None => pyo3::exceptions::PyOSError::new_err(format!("{}: {error}", path.display())),
    }
}
