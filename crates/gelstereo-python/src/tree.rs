//! Trees of settings: TOML text, and Python's dictionaries as the same tree.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PyString, PyTuple};
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// A value from TOML text; the message names the line.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    toml::from_str(text).map_err(|error| {
        let named = named(text, &error, true);
        let is_path = text.trim_end().ends_with(".toml") && !text.contains('\n');
        if is_path { format!("{named} (this is the name of a file: use load())") } else { named }
    })
}

/// The parser's message, with the line that it is about.
fn named(text: &str, error: &toml::de::Error, numbered: bool) -> String {
    let message = error.message();
    let Some((before, after)) = error.span().and_then(|span| text.split_at_checked(span.start)) else {
        return message.to_owned();
    };
    let start = before.rsplit('\n').next().unwrap_or_default();
    let line = format!("{start}{}", after.lines().next().unwrap_or_default());
    match numbered {
        true => format!("line {}, `{}`: {message}", before.matches('\n').count() + 1, line.trim()),
        false => format!("`{}`: {message}", line.trim()),
    }
}

/// TOML text of a value.
pub fn to_toml<T: Serialize>(value: &T) -> Result<String, String> {
    toml::to_string(value).map_err(|error| error.to_string())
}

/// A value with some of its settings replaced, by nested dictionaries or by dotted names.
pub fn replace<T: Serialize + DeserializeOwned>(value: &T, changes: Table) -> Result<T, String> {
    let mut tree = Table::try_from(value).map_err(|error| error.to_string())?;
    merge(&mut tree, changes);
    // Through text, because only the parser's errors say which setting they are about.
    let text = to_toml(&tree)?;
    toml::from_str(&text).map_err(|error| named(&text, &error, false))
}

/// Lays `changes` over `tree`; what is unknown is kept, for deserialisation to refuse by name.
fn merge(tree: &mut Table, changes: Table) {
    for (name, change) in changes {
        match (tree.get_mut(&name), change) {
            (Some(Value::Table(branch)), Value::Table(changes)) => merge(branch, changes),
            (_, change) => {
                tree.insert(name, change);
            }
        }
    }
}

/// A mapping's items as a table; a name with dots stands for nested tables.
pub fn table(mapping: &Bound<'_, PyMapping>) -> PyResult<Table> {
    let mut out = Table::new();
    for item in mapping.items()?.iter() {
        let (name, object): (String, Bound<'_, PyAny>) = item.extract()?;
        // None means "not there", which TOML says by leaving the name out.
        if object.is_none() {
            continue;
        }
        let mut nested = value(&object)?;
        let mut names = name.split('.').rev();
        let last = names.next_back().unwrap_or_default().to_owned();
        for name in names {
            nested = Value::Table(Table::from_iter([(name.to_owned(), nested)]));
        }
        merge(&mut out, Table::from_iter([(last, nested)]));
    }
    Ok(out)
}

fn value(object: &Bound<'_, PyAny>) -> PyResult<Value> {
    if object.is_instance_of::<PyBool>() {
        return Ok(Value::Boolean(object.extract()?));
    }
    if object.is_instance_of::<PyString>() {
        return Ok(Value::String(object.extract()?));
    }
    if object.is_instance_of::<PyFloat>() {
        return Ok(Value::Float(object.extract()?));
    }
    if object.is_instance_of::<PyInt>() {
        return Ok(Value::Integer(object.extract()?));
    }
    if let Ok(mapping) = object.cast::<PyMapping>() {
        return Ok(Value::Table(table(mapping)?));
    }
    if object.is_instance_of::<PyList>() || object.is_instance_of::<PyTuple>() {
        return Ok(Value::Array(object.try_iter()?.map(|item| value(&item?)).collect::<PyResult<_>>()?));
    }
    // Arrays and NumPy's numbers know how to become Python's.
    if object.hasattr("tolist")? {
        return value(&object.call_method0("tolist")?);
    }
    let name = object.get_type().name()?;
    Err(pyo3::exceptions::PyTypeError::new_err(format!(
        "a setting is of type {name}; valid is a number, text, a list or a dictionary"
    )))
}

/// The tree as nested dictionaries.
pub fn to_dict<'py, T: Serialize>(py: Python<'py>, value: &T) -> PyResult<Bound<'py, PyDict>> {
    let tree = Table::try_from(value).map_err(|e| crate::errors::Error::new_err(e.to_string()))?;
    dict(py, &tree)
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

/// Text of a file.
pub fn read(py: Python<'_>, path: std::path::PathBuf) -> PyResult<String> {
    py.detach(|| std::fs::read_to_string(&path)).map_err(|error| with_path(error, &path))
}

/// Writes a file.
pub fn write(py: Python<'_>, path: std::path::PathBuf, text: &str) -> PyResult<()> {
    py.detach(|| std::fs::write(&path, text)).map_err(|error| with_path(error, &path))
}

/// As Python's own `open` raises it: OSError's subclass by number, with the file's name.
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
