//! Points of every sort through what registration is built of: the nearest is that of every distance,
//! Gaussian sums are finite whatever their width, and no other rotation fits better than the one that is
//! found.
#![no_main]

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::register::{Template, rigid_fit, soft_match};
use gelstereo_core::spatial::KdTree;
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// Of a coarse lattice; or of a line or plane far away; denormal; or any number.
fn coordinate(u: &mut Unstructured<'_>, far: f64) -> Result<f64> {
    Ok(match u.int_in_range(0..=63_u8)? {
        0 => u.arbitrary()?,
        1..=3 => f64::from_bits(u.int_in_range(0..=3)?),
        4..=23 => far + f64::from(u.arbitrary::<i16>()?) / 4096.0,
        _ => far + f64::from(u.int_in_range(-2..=2_i8)?),
    })
}

fn points(u: &mut Unstructured<'_>, count: usize, far: f64) -> Result<Vec<DVec3>> {
    let mut all = Vec::with_capacity(count);
    // A coordinate of its own each, or the same for all: a plane, a line, one point.
    let flat = u.int_in_range(0..=7_u8)?;
    let mut last = DVec3::ZERO;
    for k in 0..count {
        for axis in 0..3 {
            if k == 0 || flat >> axis & 1 == 0 {
                last[axis] = coordinate(u, far)?;
            }
        }
        all.push(last);
    }
    Ok(all)
}

fn check_tree(points: &[DVec3], queries: &[DVec3]) {
    let tree = KdTree::new(points);
    for &query in queries {
        let each = || points.iter().enumerate().map(|(k, p)| (query.distance_squared(*p), k));
        let best = each().min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        assert_eq!(tree.nearest(query), best.map(|(d, k)| (k, d)));
        for radius_squared in best.map_or([1.0; 2], |(d, _)| [d, 1.0]) {
            let mut found = Vec::new();
            tree.within(query, radius_squared, &mut |k, d| found.push((d, k)));
            found.sort_unstable_by_key(|&(_, k)| k);
            assert!(found.into_iter().eq(each().filter(|(d, _)| *d <= radius_squared)));
        }
    }
}

fn check_sums(points: &[DVec3], queries: &[DVec3], sigma_mm: f64) {
    let normals: Vec<DVec3> =
        points.iter().map(|p| DVec3::from_array(p.to_array().map(|x| x % 3.0 - 1.1))).collect();
    let Ok(template) = Template::new(points, &normals, 0.5) else { return };
    for &query in queries.iter().filter(|q| q.abs().max_element() <= 1e12) {
        let soft = soft_match(&template, query, sigma_mm);
        assert!(soft.log_mass <= (points.len() as f64).ln() + 1e-9 && !soft.log_mass.is_nan(), "{soft:?}");
        assert!(soft.offset_mm.is_finite() && soft.plane_distance_mm.is_finite(), "{soft:?}");
        assert!(soft.spread_mm2 >= 0.0 && soft.spread_mm2.is_finite(), "{soft:?}");
        assert!((soft.normal.length() - 1.0).abs() < 1e-9, "{soft:?}");
        assert_eq!(template.tree().nearest(query).map(|(k, _)| k), Some(soft.nearest));
    }
}

fn check_fit(source: &[DVec3], target: &[DVec3], weights: &[f64], other: &Pose) {
    let Ok(fit) = rigid_fit(source, target, weights) else { return };
    let Pose { rotation, translation_mm } = fit.t_target_source;
    assert!((rotation.length() - 1.0).abs() < 1e-12 && translation_mm.is_finite(), "{fit:?}");
    assert!(fit.free_rotations <= 3, "{fit:?}");
    let weight = |k: usize| weights.get(k).copied().unwrap_or(1.0);
    let counted = || (0..source.len()).filter(|&k| weight(k) > 0.0);
    let most = |v: &[DVec3]| counted().map(|k| v[k].abs().max_element()).fold(1.0, f64::max);
    let size_mm = most(source).max(most(target));
    // Beyond this, squares of the comparison overflow or vanish.
    if size_mm > 1e6 || counted().any(|k| !(1e-6..1e6).contains(&weight(k))) {
        return;
    }
    let total: f64 = counted().map(weight).sum();
    let mean = |v: &[DVec3]| counted().map(|k| v[k] * weight(k)).sum::<DVec3>() / total;
    let other =
        Pose { rotation: other.rotation, translation_mm: mean(target) - other.rotation * mean(source) };
    let squares = |pose: &Pose| -> f64 {
        counted().map(|k| weight(k) * pose.transform_point(source[k]).distance_squared(target[k])).sum()
    };
    let (found, other) = (squares(&fit.t_target_source), squares(&other));
    let slack = 1e-13 * size_mm;
    assert!(
        found.sqrt() <= other.sqrt() * (1.0 + 1e-6) + 64.0 * slack * total.sqrt(),
        "{found:e} {other:e} {fit:?}"
    );
}

fn run(u: &mut Unstructured<'_>) -> Result<()> {
    let far = *u.choose(&[0.0, 0.0, 1e3, 1e6, 1e9])?;
    let count = u.int_in_range(0..=70)?;
    let source = points(u, count, far)?;
    let target = points(u, count, 0.0)?;
    let mut weights = Vec::new();
    if u.arbitrary()? {
        for _ in 0..count {
            weights.push(*u.choose(&[1.0, 0.5, 2.0, 0.0, 1e-3, 5e-324, 1e300])?);
        }
    }
    let omega = DVec3::from_array(u.arbitrary::<[i8; 3]>()?.map(|x| f64::from(x) / 40.0));
    check_fit(&source, &target, &weights, &Pose::exp(omega, DVec3::ZERO));
    let finite: Vec<DVec3> = source.into_iter().filter(|p| p.is_finite()).collect();
    let queries: Vec<DVec3> = target.into_iter().filter(|p| p.is_finite()).take(8).collect();
    check_tree(&finite, &queries);
    check_sums(&finite, &queries, *u.choose(&[0.02, 0.5, 1e-12, 1e-170, 1e3])?);
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(&mut Unstructured::new(bytes));
});
