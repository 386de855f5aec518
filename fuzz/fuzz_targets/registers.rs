//! Contacts with parts of every sort through every rung of registration and the localizer: refused by name,
//! or finite, consistent, and the same again.
#![no_main]

use gelstereo_core::digest::Digest;
use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Contact, Localizer, Registrar, Registration, Template, TrackingStatus};
use gelstereo_core::surface::TriangleMesh;
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;

const RUNGS: [RegisterMethod; 4] = [
    RegisterMethod::FilterregPoint,
    RegisterMethod::RansacIcp,
    RegisterMethod::SurfaceClose,
    RegisterMethod::SurfaceSearch,
];

/// A block about the origin; without its upper face it is open.
fn block(half_mm: DVec3, is_open: bool) -> Option<TriangleMesh> {
    let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2)) * 2.0 - 1.0;
    let places = (0..8).map(|k| corner(k) * half_mm).collect();
    let faces = [[0, 2, 3, 1], [0, 1, 5, 4], [0, 4, 6, 2], [1, 3, 7, 5], [2, 6, 7, 3], [4, 5, 7, 6]];
    let triangles = faces.iter().take(if is_open { 5 } else { 6 });
    let triangles = triangles.flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriangleMesh::new(places, triangles).ok()
}

/// Made once: a block, a thin plate, an open box, a scan of the block, and points without a surface.
fn templates() -> &'static [Template] {
    static MADE: OnceLock<Vec<Template>> = OnceLock::new();
    MADE.get_or_init(|| {
        let make = |half, is_open| Template::from_mesh(&block(half, is_open)?, 0.6, 1).ok();
        let solid = make(DVec3::new(3.0, 2.0, 5.0), false);
        let points = solid.as_ref().and_then(|t| Template::new(t.points_mm(), t.normals(), 0.6).ok());
        let turned = solid.clone().map(|t| {
            let symmetries = t.find_symmetries(0.05);
            t.with_symmetries(symmetries)
        });
        let made = [
            turned,
            make(DVec3::new(5.0, 4.0, 0.2), false),
            make(DVec3::new(3.0, 3.0, 3.0), true),
            points.clone().map(Template::with_surfels),
            points,
        ];
        let made: Vec<Template> = made.into_iter().flatten().collect();
        assert_eq!(made.len(), 5);
        made
    })
}

/// One of the templates; or what is read of its bytes after some were changed and the digest put right.
fn template(u: &mut Unstructured<'_>) -> Result<Option<Template>> {
    let made = u.choose(templates())?;
    if u.int_in_range(0..=7_u8)? > 0 {
        return Ok(Some(made.clone()));
    }
    let mut bytes = made.to_bytes();
    let end = bytes.len() - 8;
    for _ in 0..u.int_in_range(0..=3)? {
        // Half of them in what follows the points: triangles, the grid's settings and symmetries.
        let from = if u.arbitrary()? { end.saturating_sub(600) } else { 8 };
        let at = u.int_in_range(from..=end - 8)?;
        let value = if u.arbitrary()? { number(u, 10.0)?.to_le_bytes() } else { u.arbitrary()? };
        bytes[at..at + 8].copy_from_slice(&value);
    }
    let digest = Digest::new().bytes(&bytes[..end]).value();
    bytes[end..].copy_from_slice(&digest.to_le_bytes());
    let Ok(read) = Template::from_bytes(&bytes) else { return Ok(None) };
    // Places that were made one are one from then on.
    let kept = read.to_bytes();
    assert!(Template::from_bytes(&kept).is_ok_and(|again| again.to_bytes() == kept), "not what was kept");
    Ok(Some(read))
}

/// A small number, or now and then a large or any one.
fn number(u: &mut Unstructured<'_>, scale: f64) -> Result<f64> {
    Ok(match u.int_in_range(0..=255_u8)? {
        0 => u.arbitrary()?,
        1 => 0.0,
        2..=4 => f64::from(u.arbitrary::<i16>()?),
        _ => f64::from(u.arbitrary::<i16>()?) / 32768.0 * scale,
    })
}

fn vector(u: &mut Unstructured<'_>, scale: f64) -> Result<DVec3> {
    Ok(DVec3::new(number(u, scale)?, number(u, scale)?, number(u, scale)?))
}

fn settings(u: &mut Unstructured<'_>) -> Result<RegisterParams> {
    let mut params = RegisterParams { method: *u.choose(&RUNGS)?, ..RegisterParams::default() };
    params.advanced.max_iterations = u.int_in_range(1..=40)?;
    params.ransac_icp.hypotheses = 50;
    params.surface_search.starts = u.int_in_range(1..=16)?;
    params.surface_search.budget = *u.choose(&[1, 100, 10_000, 1_000_000])?;
    params.advanced.outlier_share = *u.choose(&[0.0, 0.1, 0.9])?;
    params.point_sigma_mm = *u.choose(&[0.03, 1e-6, 1.0])?;
    params.filterreg.min_sigma_mm = *u.choose(&[0.1, 1e-6])?;
    Ok(params)
}

/// Points on the part at the true pose, off it by noise; or anywhere.
fn patch(u: &mut Unstructured<'_>, template: &Template, pose: &Pose) -> Result<Vec<DVec3>> {
    let (count, noise_mm) = (u.int_in_range(0..=48)?, *u.choose(&[0.0, 0.03, 0.5])?);
    let mut random = Stream::new(u.arbitrary()?, "patch");
    let near = template.points_mm()[u.int_in_range(0..=template.points_mm().len() - 1)?];
    let mut all: Vec<DVec3> =
        template.points_mm().iter().filter(|p| p.distance(near) < 3.0).copied().collect();
    all.truncate(count);
    for p in &mut all {
        *p = pose.transform_point(*p)
            + DVec3::new(random.normal(), random.normal(), random.normal()) * noise_mm;
    }
    for _ in 0..u.int_in_range(0..=4)? {
        all.push(vector(u, 8.0)?);
    }
    Ok(all)
}

fn check(found: &Registration, points: usize) {
    let pose = &found.t_sensor_object;
    assert!((pose.rotation.length() - 1.0).abs() < 1e-9 && pose.translation_mm.is_finite(), "{pose:?}");
    assert!(found.points == points && found.inliers <= points && found.free.len() <= 6);
    assert!(found.rmse_mm >= 0.0 && found.rmse_mm.is_finite());
    assert!(found.information.iter().flatten().all(|x| x.is_finite()));
    for covariance in [found.covariance(), found.determined_covariance()] {
        assert!(covariance.iter().flatten().all(|x| x.is_finite()));
        let trace: f64 = (0..6).map(|k| covariance[k][k]).sum();
        assert!(eigen(&covariance).values[0] >= -1e-9 * trace, "{covariance:?}");
    }
    let known = found.log_likelihood.is_none_or(f64::is_finite) && found.log_odds.is_none_or(f64::is_finite);
    assert!(known, "{:?} {:?}", found.log_likelihood, found.log_odds);
    for other in found.alternatives.iter() {
        assert!(other.t_sensor_object.translation_mm.is_finite());
        assert!(Some(other.log_likelihood) <= found.log_likelihood);
    }
}

/// Of any axes: on the diagonal alone, or of a few directions, without them all singular; now and then of any
/// numbers.
fn covariance(u: &mut Unstructured<'_>) -> Result<Symmetric<3>> {
    let [x, y, z] = vector(u, 1e-3)?.abs().to_array();
    let mut out = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
    for _ in 0..u.int_in_range(0..=2)? {
        let along = vector(u, 0.05)?.to_array();
        for (row, a) in out.iter_mut().zip(along) {
            for (entry, b) in row.iter_mut().zip(along) {
                *entry += a * b;
            }
        }
    }
    if u.int_in_range(0..=63_u8)? == 0 {
        out[u.int_in_range(0..=2)?][u.int_in_range(0..=2)?] = number(u, 1e-3)?;
    }
    Ok(out)
}

/// The same contact frame by frame: as it is, slipped, and after the gripper let go.
fn follow(u: &mut Unstructured<'_>, params: &RegisterParams, given: &Given<'_>) -> Result<()> {
    let Given { contact, template, guess } = given;
    let (mut one, mut other) = (Localizer::new(params, guess), Localizer::new(params, guess));
    let mut moved = contact.points_mm.to_vec();
    for _ in 0..u.int_in_range(1..=3)? {
        let contact = Contact { points_mm: &moved, ..*contact };
        let (located, same) = (one.run(&contact, template), other.run(&contact, template));
        assert_eq!(located.is_ok(), same.is_ok());
        if let (Ok(located), Ok(same)) = (&located, &same) {
            check(&located.registration, moved.len());
            let digests = [located, same].map(|found| found.registration.digest());
            assert_eq!(digests[0], digests[1], "{:?} {:?}", located.tracking, same.tracking);
        }
        if located.is_ok_and(|found| found.tracking != TrackingStatus::Lost) {
            assert!(one.last().is_some());
        }
        let shift = vector(u, 0.3)?;
        moved.iter_mut().for_each(|p| *p += shift);
        if u.int_in_range(0..=3_u8)? == 0 {
            one.expect(guess);
            other.expect(guess);
            assert!(one.last().is_none());
        }
    }
    Ok(())
}

/// What a registration is given.
struct Given<'a> {
    contact: Contact<'a>,
    template: &'a Template,
    guess: Pose,
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let Some(template) = template(&mut u)? else { return Ok(()) };
    let template = &template;
    let params = settings(&mut u)?;
    assert_eq!(params.validate(), Ok(()));
    let truth = Pose::exp(vector(&mut u, 3.0)?, vector(&mut u, 20.0)?);
    if !(truth.rotation.is_finite() && truth.translation_mm.is_finite()) {
        return Ok(());
    }
    let guess = Pose::exp(vector(&mut u, 0.3)?, vector(&mut u, 2.0)?) * truth;
    let points_mm = patch(&mut u, template, &truth)?;
    let unpressed_mm = (0..u.int_in_range(0..=12)?).map(|_| Ok(truth.transform_point(vector(&mut u, 9.0)?)));
    let mut unpressed_mm = unpressed_mm.collect::<Result<Vec<_>>>()?;
    if u.arbitrary()? {
        // Markers of a gel around the part.
        let (middle, size) = (truth.translation_mm + vector(&mut u, 4.0)?, u.int_in_range(1..=14)?);
        let place = |k: usize| DVec3::new((k % 14) as f64 - 6.5, (k / 14) as f64 - 6.5, 0.0) * 0.9;
        unpressed_mm.extend((0..14 * size).map(|k| middle + place(k)));
    }
    let mut covariances = Vec::new();
    if u.arbitrary()? {
        for _ in 0..points_mm.len() {
            covariances.push(covariance(&mut u)?);
        }
    }
    let contact = Contact {
        points_mm: &points_mm,
        covariance_mm2: (!covariances.is_empty()).then_some(&covariances),
        unpressed_mm: &unpressed_mm,
        press_direction: *u.choose(&[DVec3::NEG_Z, DVec3::Y, truth.transform_vector(DVec3::X)])?,
        decay_mm: *u.choose(&[2.5, 0.1, 20.0, 0.0, f64::NAN])?,
        offset_sigma_mm: *u.choose(&[0.0, 0.03, 1e3, -1.0, f64::NAN])?,
    };
    let mut registrar = Registrar::new(&params);
    let first = registrar.register(&contact, template, &guess);
    if let Ok(found) = &first {
        check(found, points_mm.len());
    }
    let again = registrar.register(&contact, template, &guess);
    // Errors by what they say: one tells of a number that is none.
    let [first, again] = [first, again].map(|answer| match answer {
        Ok(found) => Ok(found.digest()),
        Err(error) => Err(format!("{error:?}")),
    });
    assert_eq!(first, again);
    follow(&mut u, &params, &Given { contact, template, guess })
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
