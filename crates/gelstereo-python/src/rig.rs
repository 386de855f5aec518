//! The calibrated stereo pair.

use crate::arrays::{self, Count, Matrix, Numbers};
use crate::errors::{RigError, ShapeError, raise};
use crate::notebook;
use crate::tree;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DMat3, DVec2, DVec3, Pose, so3};
use gelstereo_core::rig as core;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyType};
use std::path::PathBuf;

/// A calibrated stereo pair: the result of calibration and the input of triangulation.
///
/// Created by `parallel`, `from_opencv`, `from_toml` or `load`; ``gelstereo calibrate`` writes the file.
///
/// Examples
/// --------
/// >>> rig = Rig.parallel(size_px=(640, 480), f_px=560.0, baseline_mm=8.0)
/// >>> left_px, right_px = rig.project([[4.0, 0.0, 28.0]])
/// >>> print(left_px - right_px)
/// [[160. 0.]]
#[pyclass(frozen, module = "gelstereo", eq)]
#[derive(Clone, PartialEq)]
pub struct Rig {
    pub inner: core::Rig,
}

impl Rig {
    fn checked(inner: core::Rig) -> PyResult<Self> {
        inner.validate().map_err(raise)?;
        Ok(Self { inner })
    }

    fn camera(&self, view: &str) -> PyResult<&Camera> {
        match view {
            "left" => Ok(&self.inner.left),
            "right" => Ok(&self.inner.right),
            _ => {
                Err(RigError::new_err(format!("there is no view \"{view}\"; valid is \"left\" or \"right\"")))
            }
        }
    }
}

#[pymethods]
impl Rig {
    /// Two equal, parallel cameras without distortion, the right one towards +x.
    ///
    /// Parameters
    /// ----------
    /// size_px : (int, int)
    ///     Image width and height.
    /// f_px, baseline_mm : float
    ///     Focal length and distance of the cameras.
    /// c_px : (float, float), optional
    ///     Principal point. Default: the middle of the image.
    ///
    /// Raises
    /// ------
    /// RigError
    ///     If the numbers describe no rig.
    #[classmethod]
    #[pyo3(signature = (size_px, f_px, baseline_mm, c_px=None))]
    fn parallel(
        _cls: &Bound<'_, PyType>,
        size_px: (Count, Count),
        f_px: f64,
        baseline_mm: f64,
        c_px: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let (Count(width_px), Count(height_px)) = size_px;
        let centre = |side: usize| 0.5 * (side as f64 - 1.0);
        let (cx_px, cy_px) = c_px.unwrap_or((centre(width_px), centre(height_px)));
        let camera =
            Camera { width_px, height_px, fx_px: f_px, fy_px: f_px, cx_px, cy_px, distortion: [0.0; 5] };
        Self::checked(core::Rig::parallel(camera, baseline_mm))
    }

    /// From the results of ``cv2.stereoCalibrate``, with lengths in millimetres.
    ///
    /// Parameters
    /// ----------
    /// size_px : (int, int)
    ///     Image width and height.
    /// left_matrix, right_matrix : (3, 3) array_like
    ///     Camera matrices, without skew.
    /// left_distortion, right_distortion : array_like
    ///     Up to five coefficients k1, k2, p1, p2, k3 in any of OpenCV's shapes.
    /// rotation : (3, 3) array_like
    ///     Maps left camera directions to right camera directions (OpenCV's ``R``).
    /// translation_mm : (3,) or (3, 1) array_like
    ///     The left camera's origin in the right camera's frame (OpenCV's ``T``).
    ///
    /// Raises
    /// ------
    /// RigError, PoseError, ShapeError
    ///     If the numbers describe no rig.
    #[classmethod]
    #[pyo3(signature = (
        *, size_px, left_matrix, left_distortion, right_matrix, right_distortion, rotation, translation_mm
    ))]
    #[allow(clippy::too_many_arguments)] // what cv2.stereoCalibrate returns
    fn from_opencv(
        _cls: &Bound<'_, PyType>,
        size_px: (Count, Count),
        left_matrix: &Bound<'_, PyAny>,
        left_distortion: &Bound<'_, PyAny>,
        right_matrix: &Bound<'_, PyAny>,
        right_distortion: &Bound<'_, PyAny>,
        rotation: &Bound<'_, PyAny>,
        translation_mm: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let rotation = Numbers::new(rotation, "rotation")?.matrix::<3, 3>()?;
        let translation = three(&Numbers::new(translation_mm, "translation_mm")?)?;
        let rotation = so3::from_matrix(&DMat3::from_cols_array_2d(&rotation).transpose()).map_err(raise)?;
        Self::checked(core::Rig {
            left: camera(
                size_px,
                &Numbers::new(left_matrix, "left_matrix")?,
                &Numbers::new(left_distortion, "left_distortion")?,
            )?,
            right: camera(
                size_px,
                &Numbers::new(right_matrix, "right_matrix")?,
                &Numbers::new(right_distortion, "right_distortion")?,
            )?,
            t_right_left: Pose { rotation, translation_mm: translation },
            layers: None,
        })
    }

    /// A rig from TOML text.
    ///
    /// Raises
    /// ------
    /// RigError
    ///     If the text is not a rig; the message names the line or the error.
    #[classmethod]
    fn from_toml(_cls: &Bound<'_, PyType>, text: &str) -> PyResult<Self> {
        Self::checked(tree::from_toml(text).map_err(RigError::new_err)?)
    }

    /// The rig as TOML text; `from_toml` restores an equal value.
    fn to_toml(&self) -> PyResult<String> {
        tree::to_toml(&self.inner).map_err(RigError::new_err)
    }

    /// A rig from a TOML file; see `from_toml`.
    #[classmethod]
    fn load<'py>(cls: &Bound<'py, PyType>, path: PathBuf) -> PyResult<Bound<'py, PyAny>> {
        tree::load(cls, path)
    }

    /// Write the rig to a TOML file.
    fn save(slf: &Bound<'_, Self>, path: PathBuf) -> PyResult<()> {
        tree::save(slf, path)
    }

    /// Width and height of the left image, pixels.
    #[getter]
    fn size_px(&self) -> (usize, usize) {
        (self.inner.left.width_px, self.inner.left.height_px)
    }

    /// (3, 3) camera matrix of the left camera, pixels.
    #[getter]
    fn left_matrix(&self, py: Python<'_>) -> PyResult<Matrix> {
        camera_matrix(py, &self.inner.left)
    }

    /// (3, 3) camera matrix of the right camera, pixels.
    #[getter]
    fn right_matrix(&self, py: Python<'_>) -> PyResult<Matrix> {
        camera_matrix(py, &self.inner.right)
    }

    /// (5,) k1, k2, p1, p2, k3 of the left camera.
    #[getter]
    fn left_distortion(&self, py: Python<'_>) -> arrays::Array1<f64> {
        arrays::list(py, self.inner.left.distortion.to_vec())
    }

    /// (5,) k1, k2, p1, p2, k3 of the right camera.
    #[getter]
    fn right_distortion(&self, py: Python<'_>) -> arrays::Array1<f64> {
        arrays::list(py, self.inner.right.distortion.to_vec())
    }

    /// (4, 4) motion that maps left camera coordinates to right camera coordinates, mm.
    #[getter]
    fn t_right_left(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::pose_matrix(py, &self.inner.t_right_left)
    }

    /// Distance between the cameras, mm.
    #[getter]
    fn baseline_mm(&self) -> f64 {
        self.inner.baseline_mm()
    }

    /// Flat layers in front of the markers, or None. A dictionary with the unit ``normal`` of the
    /// interfaces away from the cameras (sensor frame), ``gap_mm`` from the left camera to the first
    /// interface, ``plates``, a list of ``thickness_mm`` and refractive ``index``, and the ``gel_index``.
    #[getter]
    fn layers<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.inner.layers.as_ref().map(|layers| tree::to_dict(py, layers)).transpose()
    }

    /// A copy of this rig with other layers.
    ///
    /// Parameters
    /// ----------
    /// layers : mapping or None
    ///     In the form of `layers`.
    ///
    /// Raises
    /// ------
    /// RigError
    ///     If the numbers are not valid layers, or a camera lies within them.
    ///
    /// Examples
    /// --------
    /// >>> rig = Rig.parallel(size_px=(640, 480), f_px=600.0, baseline_mm=10.0).with_layers({
    /// ...     "normal": [0.0, 0.0, 1.0], "gap_mm": 20.0,
    /// ...     "plates": [{"thickness_mm": 3.0, "index": 1.49}], "gel_index": 1.41,
    /// ... })
    /// >>> origins_mm, directions = rig.rays([[319.5, 239.5]])
    /// >>> print(origins_mm, directions)
    /// [[ 0. 0. 23.]] [[0. 0. 1.]]
    fn with_layers(&self, layers: Option<&Bound<'_, PyMapping>>) -> PyResult<Self> {
        let layers = layers.map(tree::from_mapping).transpose().map_err(RigError::new_err)?;
        Self::checked(core::Rig { layers, ..self.inner.clone() })
    }

    /// The row-aligned virtual cameras, with Q of Eq. 3.
    fn rectification(&self) -> PyResult<Rectification> {
        Ok(Rectification { inner: self.inner.rectification().map_err(raise)? })
    }

    /// Pixels of points in both views, through the layers if the rig has any.
    ///
    /// Parameters
    /// ----------
    /// points_mm : (N, 3) array_like
    ///     Sensor frame.
    ///
    /// Returns
    /// -------
    /// left_px, right_px : (N, 2) float64
    ///
    /// Raises
    /// ------
    /// RigError
    ///     If a point is not in front of both cameras, or its light is totally reflected in the layers.
    fn project(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<(Matrix, Matrix)> {
        let points = Numbers::new(points_mm, "points_mm")?;
        let points = points.rows::<DVec3, 3>()?;
        let (mut left, mut right) = (Vec::with_capacity(points.len()), Vec::with_capacity(points.len()));
        for (index, &point) in points.iter().enumerate() {
            let (l, r) = self
                .inner
                .project(point)
                .map_err(|error| RigError::new_err(format!("point {index}: {error}")))?;
            left.push(l);
            right.push(r);
        }
        Ok((arrays::rows::<_, 2>(py, left)?, arrays::rows::<_, 2>(py, right)?))
    }

    /// Normalised coordinates (x / z, y / z) of pixels, with lens distortion removed.
    ///
    /// Parameters
    /// ----------
    /// pixels_px : (N, 2) array_like
    /// view : {"left", "right"}
    ///
    /// Returns
    /// -------
    /// (N, 2) float64
    ///
    /// Raises
    /// ------
    /// RigError
    ///     If a pixel lies where the distortion model cannot be inverted.
    #[pyo3(signature = (pixels_px, view="left"))]
    fn undistort(&self, py: Python<'_>, pixels_px: &Bound<'_, PyAny>, view: &str) -> PyResult<Matrix> {
        let camera = self.camera(view)?;
        let pixels = Numbers::new(pixels_px, "pixels_px")?;
        let out = pixels.rows::<DVec2, 2>()?.iter().map(|&p| camera.undistort(p)).collect::<Result<_, _>>();
        arrays::rows::<DVec2, 2>(py, out.map_err(raise)?)
    }

    /// Rays of the points seen at the given pixels: in the gel from the last interface on, or from the
    /// camera without layers.
    ///
    /// Parameters
    /// ----------
    /// pixels_px : (N, 2) array_like
    /// view : {"left", "right"}
    ///
    /// Returns
    /// -------
    /// origins_mm, directions : (N, 3) float64
    ///     Sensor frame; the directions are unit vectors.
    ///
    /// Raises
    /// ------
    /// RigError
    ///     If a pixel has no ray, or one that never meets the layers.
    #[pyo3(signature = (pixels_px, view="left"))]
    fn rays(&self, py: Python<'_>, pixels_px: &Bound<'_, PyAny>, view: &str) -> PyResult<(Matrix, Matrix)> {
        self.camera(view)?;
        let view = self.inner.view(if view == "left" { core::View::Left } else { core::View::Right });
        let pixels = Numbers::new(pixels_px, "pixels_px")?;
        let rays = pixels.rows::<DVec2, 2>()?.iter().map(|&p| view.ray(p)).collect::<Result<Vec<_>, _>>();
        let rays = rays.map_err(raise)?;
        Ok((
            arrays::rows::<_, 3>(py, rays.iter().map(|ray| ray.origin_mm).collect())?,
            arrays::rows::<_, 3>(py, rays.iter().map(|ray| ray.direction).collect())?,
        ))
    }

    /// HTML for notebooks.
    fn _repr_html_(slf: &Bound<'_, Self>) -> PyResult<String> {
        notebook::html(slf.as_any(), "rig_html")
    }

    fn __repr__(&self) -> String {
        let c = &self.inner.left;
        format!(
            "Rig({} x {} px, f {:.2} px, baseline {:.4} mm)",
            c.width_px,
            c.height_px,
            c.fx_px,
            self.inner.baseline_mm()
        )
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<tree::Reduced<'py>> {
        tree::reduce(slf)
    }
}

/// Row-aligned virtual cameras of a rig, as from ``cv2.stereoRectify``, with the mean focal length and
/// principal point of the two cameras.
#[pyclass(frozen, module = "gelstereo")]
pub struct Rectification {
    inner: core::Rectification,
}

#[pymethods]
impl Rectification {
    fn __repr__(&self) -> String {
        let (f_px, baseline_mm) = (self.inner.f_px, self.inner.baseline_mm);
        format!("<Rectification: focal length {f_px:.2} px, baseline {baseline_mm:.3} mm>")
    }

    /// (3, 3) rotation from left camera coordinates to rectified ones.
    #[getter]
    fn r_left(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.r_left.transpose().to_cols_array_2d())
    }

    /// (3, 3) rotation from right camera coordinates to rectified ones.
    #[getter]
    fn r_right(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.r_right.transpose().to_cols_array_2d())
    }

    /// Focal length of both virtual cameras, pixels.
    #[getter]
    fn f_px(&self) -> f64 {
        self.inner.f_px
    }

    /// Principal point of both virtual cameras, pixels.
    #[getter]
    fn c_px(&self) -> (f64, f64) {
        (self.inner.c_px.x, self.inner.c_px.y)
    }

    /// Distance between the cameras, mm.
    #[getter]
    fn baseline_mm(&self) -> f64 {
        self.inner.baseline_mm
    }

    /// (4, 4) Q of Eq. 3: (X, Y, Z, W) = Q (x, y, d, 1) with d = x_left - x_right.
    #[getter]
    fn q(&self, py: Python<'_>) -> PyResult<Matrix> {
        arrays::matrix(py, self.inner.q())
    }
}

fn camera(
    (Count(width_px), Count(height_px)): (Count, Count),
    matrix: &Numbers<'_>,
    distortion: &Numbers<'_>,
) -> PyResult<Camera> {
    let k = matrix.matrix::<3, 3>()?;
    let pinhole = k[0][1] == 0.0 && k[1][0] == 0.0 && k[2] == [0.0, 0.0, 1.0];
    if !pinhole {
        return Err(RigError::new_err(format!(
            "the camera matrix is {k:?}; valid is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] without skew"
        )));
    }
    let found = distortion.flat()?;
    if found.len() > 5 {
        return Err(RigError::new_err(format!(
            "there are {} distortion coefficients; valid is up to 5 (k1, k2, p1, p2, k3): calibrate without \
             CALIB_RATIONAL_MODEL and its kin",
            found.len()
        )));
    }
    let distortion = std::array::from_fn(|i| found.get(i).copied().unwrap_or(0.0));
    Ok(Camera {
        width_px,
        height_px,
        fx_px: k[0][0],
        fy_px: k[1][1],
        cx_px: k[0][2],
        cy_px: k[1][2],
        distortion,
    })
}

/// Accepts OpenCV's translations, which are (3, 1).
fn three(numbers: &Numbers<'_>) -> PyResult<DVec3> {
    let values: [f64; 3] = numbers.flat()?.try_into().map_err(|_| {
        ShapeError::new_err("translation_mm does not have 3 numbers; valid is the shape (3,) or (3, 1)")
    })?;
    Ok(DVec3::from_array(values))
}

fn camera_matrix(py: Python<'_>, camera: &Camera) -> PyResult<Matrix> {
    arrays::matrix(
        py,
        [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]],
    )
}
