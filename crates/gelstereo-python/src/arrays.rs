//! Conversion of arrays. Results are moved to NumPy and returned read-only; inputs are borrowed where
//! their memory layout allows it.

use crate::errors::{ImageError, PoseError, ShapeError, raise};
use bytemuck::{AnyBitPattern, NoUninit};
use gelstereo_core::color::ColorView;
use gelstereo_core::image::GrayView;
use gelstereo_core::math::Pose;
use gelstereo_core::params::{Channel, DetectParams};
use numpy::ndarray::{Array, ShapeBuilder, StrideShape};
use numpy::{
    Element, IntoPyArray, PyArray, PyArray1, PyArray2, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods,
    PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

pub type Array1<T> = Py<PyArray1<T>>;
pub type Matrix = Py<PyArray2<f64>>;

/// A read-only array that takes over the vector's memory.
pub fn list<T: Element>(py: Python<'_>, values: Vec<T>) -> Array1<T> {
    let array = values.into_pyarray(py);
    let _ = array.readwrite().make_nonwriteable();
    array.unbind()
}

/// A read-only (N, W) array that takes over the memory of N vectors of W numbers.
pub fn rows<V: NoUninit + AnyBitPattern, const W: usize>(py: Python<'_>, values: Vec<V>) -> PyResult<Matrix> {
    let shape = (values.len(), W);
    shaped(py, bytemuck::allocation::cast_vec(values), shape)
}

/// A read-only (H, W) matrix.
pub fn matrix<const H: usize, const W: usize>(py: Python<'_>, values: [[f64; W]; H]) -> PyResult<Matrix> {
    shaped(py, values.concat(), (H, W))
}

/// A read-only array of any shape that takes over the memory of its elements.
pub fn shaped<T: Element, Sh>(py: Python<'_>, values: Vec<T>, shape: Sh) -> PyResult<Py<PyArray<T, Sh::Dim>>>
where
    Sh: ShapeBuilder + Into<StrideShape<Sh::Dim>>,
{
    let array = Array::from_shape_vec(shape, values).map_err(|e| ShapeError::new_err(e.to_string()))?;
    let array = array.into_pyarray(py);
    let _ = array.readwrite().make_nonwriteable();
    Ok(array.unbind())
}

/// A pose as a read-only (4, 4) matrix.
pub fn pose_matrix(py: Python<'_>, pose: &Pose) -> PyResult<Matrix> {
    matrix(py, pose.to_rows())
}

/// Numbers of any real type as a C-contiguous float64 array; copied only if they are not one already.
pub struct Numbers<'py> {
    array: PyReadonlyArrayDyn<'py, f64>,
    name: &'static str,
}

impl<'py> Numbers<'py> {
    pub fn new(object: &Bound<'py, PyAny>, name: &'static str) -> PyResult<Self> {
        // Most inputs have the right type already, and a NumPy conversion takes microseconds.
        if let Ok(array) = object.cast::<PyArrayDyn<f64>>()
            && array.is_c_contiguous()
            && array.ndim() > 0
        {
            return Ok(Self { array: array.readonly(), name });
        }
        let py = object.py();
        let fail = |found: String| {
            ShapeError::new_err(format!("{name} is {found}; valid is an array of real numbers"))
        };
        let numpy = py.import("numpy")?;
        let plain = numpy
            .call_method1("asarray", (object,))
            .map_err(|_| fail(describe(object)))?
            .cast_into::<PyUntypedArray>()?;
        if !matches!(plain.dtype().kind(), b'f' | b'i' | b'u' | b'b') {
            return Err(fail(describe(&plain)));
        }
        let kwargs = PyDict::new(py);
        kwargs.set_item("dtype", "float64")?;
        let array = numpy.call_method("ascontiguousarray", (plain,), Some(&kwargs))?;
        Ok(Self { array: array.cast_into::<PyArrayDyn<f64>>()?.readonly(), name })
    }

    /// The rows of an (N, W) array.
    pub fn rows<V: NoUninit + AnyBitPattern, const W: usize>(&self) -> PyResult<&[V]> {
        let shape = self.array.shape();
        if shape.len() != 2 || shape[1] != W {
            return Err(self.wrong_shape(&format!("(N, {W})")));
        }
        Ok(bytemuck::cast_slice(self.array.as_slice()?))
    }

    /// The 3x3 matrices of an (N, 3, 3) or (N, 9) array.
    pub fn matrices(&self) -> PyResult<&[[[f64; 3]; 3]]> {
        match self.array.shape() {
            [_, 3, 3] | [_, 9] => Ok(bytemuck::cast_slice(self.array.as_slice()?)),
            _ => Err(self.wrong_shape("(N, 3, 3)")),
        }
    }

    /// The numbers of an (N,) array.
    pub fn list(&self) -> PyResult<&[f64]> {
        if self.array.shape().len() != 1 {
            return Err(self.wrong_shape("(N,)"));
        }
        Ok(self.array.as_slice()?)
    }

    /// The numbers of an array of any OpenCV shape for N numbers: (N,), (N, 1), (1, N).
    pub fn flat(&self) -> PyResult<&[f64]> {
        Ok(self.array.as_slice()?)
    }

    /// An (N,) vector.
    pub fn vector<const N: usize>(&self) -> PyResult<[f64; N]> {
        let shape = self.array.shape();
        let values = if shape.len() == 1 { self.array.as_slice()? } else { &[] };
        values.try_into().map_err(|_| self.wrong_shape(&format!("({N},)")))
    }

    /// An (H, W) matrix.
    pub fn matrix<const H: usize, const W: usize>(&self) -> PyResult<[[f64; W]; H]> {
        if self.array.shape() != [H, W] {
            return Err(self.wrong_shape(&format!("({H}, {W})")));
        }
        let values = self.array.as_slice()?;
        Ok(std::array::from_fn(|i| std::array::from_fn(|j| values[i * W + j])))
    }

    fn wrong_shape(&self, valid: &str) -> PyErr {
        let shape = shape_text(self.array.shape());
        ShapeError::new_err(format!("{} has the shape {shape}; valid is {valid}", self.name))
    }
}

/// A non-negative integer. PyO3's own conversion of a negative or too large one raises an `OverflowError`
/// that does not state the valid range.
#[derive(Clone, Copy)]
pub struct Count(pub usize);

impl<'py> FromPyObject<'_, 'py> for Count {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        match object.extract::<usize>() {
            Ok(count) => Ok(Self(count)),
            Err(error) if error.is_instance_of::<PyOverflowError>(object.py()) => {
                let found = object.repr()?;
                let found: String = found.to_string_lossy().chars().take(40).collect();
                Err(ShapeError::new_err(format!("a count is {found}; valid is from 0 to {}", usize::MAX)))
            }
            Err(error) => Err(error),
        }
    }
}

/// A (4, 4) rigid motion.
pub fn pose(object: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Pose> {
    let values = Numbers::new(object, name)?.matrix::<4, 4>()?;
    Pose::from_rows(&values).map_err(|e| PoseError::new_err(format!("{name}: {e}")))
}

/// An image, grey or in colour, borrowed if its rows are contiguous, copied otherwise (a slice of a larger
/// image, every second pixel, a flipped view).
pub enum Image<'py> {
    Grey(Pixels<'py>),
    Color(Pixels<'py>),
}

/// The bytes of an image, row by row.
pub struct Pixels<'py> {
    bytes: Bytes<'py>,
    height: usize,
    width: usize,
}

enum Bytes<'py> {
    Borrowed(PyReadonlyArrayDyn<'py, u8>),
    Copied(Vec<u8>),
}

impl Pixels<'_> {
    fn bytes(&self) -> PyResult<&[u8]> {
        match &self.bytes {
            Bytes::Borrowed(array) => Ok(array.as_slice()?),
            Bytes::Copied(bytes) => Ok(bytes),
        }
    }
}

impl<'py> Image<'py> {
    pub fn new(object: &Bound<'py, PyAny>, name: &str) -> PyResult<Self> {
        let fail = |found: String, hint: &str| {
            ImageError::new_err(format!(
                "{name} is {found}; valid is a uint8 array (height, width), or (height, width, 3) of blue, \
                 green and red{hint}"
            ))
        };
        let Ok(array) = object.cast::<PyUntypedArray>() else {
            return Err(fail(describe(object), ": np.asarray() makes one"));
        };
        let hint = match array.shape() {
            [_, _] | [_, _, 3] => "",
            [_, _, 4] => ": cv2.cvtColor() removes the alpha channel",
            [_, _, 1] => ": image[..., 0] is a grey one",
            _ => return Err(fail(describe(array), "")),
        };
        if !hint.is_empty() || array.dtype().kind() != b'u' || array.dtype().itemsize() != 1 {
            return Err(fail(describe(array), hint));
        }
        let (height, width, color) = (array.shape()[0], array.shape()[1], array.ndim() == 3);
        let array = array.cast::<PyArrayDyn<u8>>()?.readonly();
        let bytes =
            if array.is_c_contiguous() { Bytes::Borrowed(array) } else { Bytes::Copied(copied(&array)) };
        let pixels = Pixels { bytes, height, width };
        Ok(if color { Self::Color(pixels) } else { Self::Grey(pixels) })
    }

    /// The best channel of a colour image for this print, and grey of a grey one.
    pub fn best_channel(&self, params: &DetectParams) -> PyResult<Channel> {
        match self {
            Self::Grey(_) => Ok(Channel::Grey),
            Self::Color(pixels) => Ok(color(pixels)?.best_channel(params)),
        }
    }

    /// The grey image itself, or one channel of a colour image, which is written into `channel_levels`.
    pub fn view<'a>(&'a self, channel: Channel, channel_levels: &'a mut Vec<u8>) -> PyResult<GrayView<'a>> {
        let (pixels, bytes): (_, &[u8]) = match self {
            Self::Grey(pixels) => (pixels, pixels.bytes()?),
            Self::Color(pixels) => {
                color(pixels)?.write(channel, channel_levels);
                (pixels, channel_levels)
            }
        };
        GrayView::new(bytes, pixels.width, pixels.height, pixels.width).map_err(raise)
    }
}

fn color<'a>(pixels: &'a Pixels<'_>) -> PyResult<ColorView<'a>> {
    ColorView::new(pixels.bytes()?, pixels.width, pixels.height, 3 * pixels.width).map_err(raise)
}

fn copied(array: &PyReadonlyArrayDyn<'_, u8>) -> Vec<u8> {
    let view = array.as_array();
    let mut bytes = Vec::with_capacity(view.len());
    for row in view.outer_iter() {
        // One half of a side-by-side frame has contiguous rows.
        match row.as_slice() {
            Some(row) => bytes.extend_from_slice(row),
            None => bytes.extend(row.iter()),
        }
    }
    bytes
}

/// The word of a channel in `detect.channel`.
pub const fn channel_name(channel: Channel) -> &'static str {
    match channel {
        Channel::Auto => "auto",
        Channel::Grey => "grey",
        Channel::Red => "red",
        Channel::Green => "green",
        Channel::Blue => "blue",
    }
}

/// Describes an object for messages: "a float32 array (480, 640)", "a list".
fn describe(object: &Bound<'_, PyAny>) -> String {
    if let Ok(array) = object.cast::<PyUntypedArray>() {
        return format!("a {} array {}", array.dtype(), shape_text(array.shape()));
    }
    let name = object.get_type().name().map_or_else(|_| "object".into(), |name| name.to_string());
    format!("of type {name}")
}

fn shape_text(shape: &[usize]) -> String {
    let sides: Vec<String> = shape.iter().map(ToString::to_string).collect();
    if sides.len() == 1 { format!("({},)", sides[0]) } else { format!("({})", sides.join(", ")) }
}
