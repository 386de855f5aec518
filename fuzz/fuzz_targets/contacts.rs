//! Clouds of a lattice through the pressure of the gel and the dense surface: refused by name, or finite,
//! complete, and the same again.
#![no_main]

use gelstereo_core::contact::{Pressure, RestSurface};
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::surface::{DenseFrame, DenseSurface};
use gelstereo_core::track::MarkerState;
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// A small number, or now and then a large or any one.
fn number(u: &mut Unstructured<'_>) -> Result<f64> {
    Ok(match u.int_in_range(0..=127_u8)? {
        0 => u.arbitrary()?,
        1..=4 => f64::from(u.arbitrary::<i16>()?) / 64.0,
        5..=40 => f64::from(u.arbitrary::<i8>()?) / 128.0,
        _ => 0.0,
    })
}

fn cloud(u: &mut Unstructured<'_>, rows: usize, cols: usize) -> Result<Vec<DVec3>> {
    let place = |n: usize| DVec3::new((n % cols) as f64 * 0.9, (n / cols) as f64 * 0.9, 28.0);
    (0..rows * cols).map(|n| Ok(place(n) + DVec3::new(number(u)?, number(u)?, number(u)?))).collect()
}

fn press(
    u: &mut Unstructured<'_>,
    rest: &RestSurface,
    now_mm: &[DVec3],
    (rows, cols): (usize, usize),
) -> Result<()> {
    let decay_mm = *u.choose(&[0.4, 1.0, 4.0, 1e-3, 1e3, 0.0, f64::NAN])?;
    let Ok(mut pressure) = Pressure::new(rest, rows, cols, decay_mm) else { return Ok(()) };
    let mut indentation_mm = Vec::new();
    if rest.indentation_mm(now_mm, &mut indentation_mm).is_err() {
        return Ok(());
    }
    let (mut variance_mm2, mut state) = (Vec::new(), Vec::new());
    for _ in 0..now_mm.len() {
        variance_mm2.push(match u.int_in_range(0..=63_u8)? {
            0 => u.arbitrary()?,
            n => 1e-6 * f64::from(n) * f64::from(n),
        });
        state.push(*u.choose(&[
            MarkerState::Seen,
            MarkerState::Seen,
            MarkerState::Held,
            MarkerState::Lost,
        ])?);
    }
    let (mut salient, mut again) = (Vec::new(), Vec::new());
    let first = pressure.run(&indentation_mm, variance_mm2.iter().copied(), &state, &mut salient);
    let second = pressure.run(&indentation_mm, variance_mm2.iter().copied(), &state, &mut again);
    assert_eq!(first, second);
    assert_eq!(salient, again);
    assert_eq!(salient.len(), if first.is_ok() { now_mm.len() } else { 0 });
    assert!(salient.iter().zip(&state).all(|(&salient, &state)| !salient || state == MarkerState::Seen));
    Ok(())
}

fn interpolate(u: &mut Unstructured<'_>, rest_mm: &[DVec2], now_mm: &[DVec3]) -> Result<()> {
    let step_mm = match u.int_in_range(0..=15_u8)? {
        0 => u.arbitrary()?,
        n => f64::from(n) * 0.1,
    };
    // Millions of cells are valid, but slow.
    let spread = rest_mm.iter().fold(DVec2::ZERO, |most, p| most.max(p.abs()));
    if spread.max_element() / step_mm > 100.0 {
        return Ok(());
    }
    let Ok(mut surface) = DenseSurface::new(rest_mm, step_mm) else { return Ok(()) };
    let cells = surface.rows() * surface.cols();
    for cell in 0..cells {
        let sum: f64 = surface.weights_of(cell).iter().map(|&(_, weight)| weight).sum();
        assert!(
            !surface.is_known(cell) || (sum - 1.0).abs() < 1e-9,
            "weights of cell {cell} add up to {sum}"
        );
    }
    let mut frame = DenseFrame::default();
    if surface.run(now_mm, &mut frame).is_ok() {
        assert_eq!((frame.points_mm.len(), frame.normals.len()), (cells, cells));
        assert!(frame.points_mm.iter().chain(&frame.normals).all(|p| p.is_finite()));
        let unit = |cell: usize| (frame.normals[cell].length() - 1.0).abs() < 1e-9;
        assert!((0..cells).all(|cell| !surface.is_known(cell) || unit(cell)));
    } else {
        assert!(frame.points_mm.is_empty() && frame.normals.is_empty());
    }
    Ok(())
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let (rows, cols) = (u.int_in_range(1..=9)?, u.int_in_range(1..=9)?);
    let (rest_mm, now_mm) = (cloud(&mut u, rows, cols)?, cloud(&mut u, rows, cols)?);
    let places: Vec<DVec2> = rest_mm.iter().map(|p| p.truncate()).collect();
    interpolate(&mut u, &places, &now_mm)?;
    if let Ok(rest) = RestSurface::new(&rest_mm) {
        press(&mut u, &rest, &now_mm, (rows, cols))?;
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
