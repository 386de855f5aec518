//! No stage allocates after its first frame, not even when a later one holds more.

use crate::counting;
use crate::support;

use counting::ALLOCATIONS;
use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::detect::Found;
use gelstereo_core::detect::{Detector, Folds, Markers};
use gelstereo_core::lattice::{FoundLattice, LatticeFinder, anchor, foresight_sort, rest_lattice};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params::{
    Background, Centre, FindAt, Params, Threshold, TriangulateMethod, TriangulateParams,
};
use gelstereo_core::rig::Rig;
use gelstereo_core::track::{ScatteredTracker, Tracker, Tracks};
use gelstereo_core::triangulate::{Centres, Triangulator};
use support::{Dots, paper_lattice, view};

fn allocations(mut work: impl FnMut()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

#[test]
fn detection_allocates_for_the_first_image_only() {
    let few = Dots::new(640, 480, paper_lattice()[..100].to_vec()).render();
    let mut stream = Stream::new(1, "noise");
    // The most components there can be, and the most runs.
    let noise: Vec<u8> = (0..640 * 480).map(|_| stream.next_u64() as u8).collect();
    let stripes: Vec<u8> = (0..640 * 480).map(|n| if n % 2 == 0 { 0 } else { 255 }).collect();
    let backgrounds = [Background::Gaussian, Background::Blocks];
    let thresholds = [Threshold::Fixed, Threshold::Auto];
    for (background, threshold) in backgrounds.into_iter().flat_map(|b| thresholds.map(|t| (b, t))) {
        for (centre, kernel_px) in [
            (Centre::Binary, 1),
            (Centre::Grey, 1),
            (Centre::SoftThreshold, 1),
            (Centre::Grey, 5),
            (Centre::Fit, 1),
        ] {
            let mut params = Params::default().detect;
            (params.background, params.threshold, params.centre) = (background, threshold, centre);
            (params.morphology_kernel_px, params.min_area_px2, params.smooth_kernel_px) = (kernel_px, 1, 1);
            let (mut detector, mut markers) = (Detector::new(&params), Markers::default());
            let first = allocations(|| detector.run(view(&few, 640), &mut markers).unwrap());
            assert!(first > 0, "the counter counts");
            let later = allocations(|| {
                for image in [&noise, &few, &stripes] {
                    // With more components than there is room for, it refuses.
                    let _ = detector.run(view(image, 640), &mut markers);
                }
            });
            assert_eq!(later, 0, "{background:?} {threshold:?} {centre:?} {kernel_px}");
        }
    }
}

#[test]
fn folds_in_single_images_allocate_nothing_once_there_is_room() {
    let mut stream = Stream::new(1, "folds");
    let mut scattered = |across: f64| {
        let mut at = || DVec2::new(640.0 * stream.uniform(), across * stream.uniform());
        Markers::at((0..625).map(|_| at()).collect(), 0.02)
    };
    let mut markers = [Markers::at(paper_lattice(), 0.02), scattered(480.0), scattered(1.0), scattered(0.0)];
    let mut folds = Folds::default();
    assert!(allocations(|| folds.reserve(625)) > 0);
    assert_eq!(allocations(|| markers.iter_mut().for_each(|markers| folds.widen(markers))), 0);
}

/// Also when only the first image shows all of its markers at half its size.
#[test]
fn an_image_that_half_its_size_does_not_show_allocates_nothing() {
    let clear = Dots::new(640, 480, paper_lattice()).render();
    let mut stream = Stream::new(1, "noise");
    let noise: Vec<u8> = (0..640 * 480).map(|_| stream.next_u64() as u8).collect();
    let fine = Dots { radius_px: 2.0, ..Dots::new(640, 480, paper_lattice()) }.render();
    let (mut detector, mut markers) =
        (Detector::new(&Params::preset("fast").unwrap().detect), Markers::default());
    let mut search = |image: &[u8], at: FindAt| {
        let _ = detector.run(view(image, 640), &mut markers);
        assert_eq!(detector.found_at(), at);
    };
    assert!(allocations(|| search(&clear, FindAt::HalfSize)) > 0);
    let later = || [&fine, &noise, &fine].into_iter().for_each(|image| search(image, FindAt::FullSize));
    assert_eq!(allocations(later), 0);
}

#[test]
fn the_search_in_windows_allocates_nothing_once_there_is_room() {
    let truth = paper_lattice();
    let few = Dots::new(640, 480, truth[..100].to_vec()).render();
    let mut stream = Stream::new(1, "noise");
    let noise: Vec<u8> = (0..640 * 480).map(|_| stream.next_u64() as u8).collect();
    let mut detector = Detector::new(&Params::preset("balanced").unwrap().detect);
    let (kind, mut found) = (detector.size_for_windows(58.0, 17.6).unwrap(), Found::default());
    assert!(allocations(|| detector.reserve_windows(truth.len(), &kind, (640, 480), &mut found)) > 0);
    let mut search = |image: &[u8]| detector.run_windows(view(image, 640), &truth, 8.8, &kind, &mut found);
    assert_eq!(allocations(|| [&noise, &few, &noise].into_iter().for_each(|i| search(i))), 0);
}

#[test]
fn tracks_and_sort_allocate_for_the_first_frame_only() {
    let params = Params::default();
    let truth = paper_lattice();
    let rest = rest_lattice(&truth, &params.lattice, params.label.tolerance_pitches).unwrap();
    let (mut tracker, mut tracks) = (Tracker::new(&params.track), Tracks::default());
    let mut markers = Markers::at(truth.to_vec(), 0.1);
    tracker.initialise(&rest, &markers, &mut tracks);
    let (mut order, mut copy) = (Vec::new(), tracks.clone());
    let mut frame = |shift: f64| {
        for (centre, &at) in markers.centres_px.iter_mut().zip(&truth) {
            *centre = at + shift;
        }
        allocations(|| {
            copy.clone_from(&tracks);
            tracker.run(&markers, &mut tracks);
            foresight_sort(&tracks.positions_px, 25, 25, rest.pitch_px / 3.0, &mut order).unwrap();
        })
    };
    frame(1.0);
    assert_eq!((2..20).map(|step| frame(f64::from(step))).sum::<usize>(), 0);
}

#[test]
fn scattered_tracks_allocate_at_rest_only() {
    let (truth, mut stream) = (paper_lattice(), Stream::new(3, "scattered"));
    let (mut tracker, mut tracks) =
        (ScatteredTracker::new(&Params::default().track, (640, 480)), Tracks::default());
    let mut markers = Markers::at(truth.to_vec(), 0.1);
    tracker.initialise(&markers, 800, &mut tracks).unwrap();
    // Small steps, steps beyond the gate, and clutter.
    let mut frame = |shift_px: f64, clutter: usize| {
        for (n, (centre, &at)) in markers.centres_px.iter_mut().zip(&truth).enumerate() {
            let elsewhere = DVec2::new(stream.uniform() * 640.0, stream.uniform() * 480.0);
            *centre = if n < clutter { elsewhere } else { at + shift_px };
        }
        allocations(|| {
            let _ = tracker.run(&markers, &mut tracks);
        })
    };
    let steps = [(1.0, 0), (3.0, 40), (30.0, 0), (0.0, 600), (5.0, 100)];
    assert_eq!(steps.map(|(shift_px, clutter)| frame(shift_px, clutter)), [0; 5]);
}

#[test]
fn the_lattice_is_found_and_anchored_without_allocating_after_the_first_frame() {
    let truth = paper_lattice();
    let mut stream = Stream::new(2, "specks");
    let (mut finder, mut found) = (LatticeFinder::default(), FoundLattice::default());
    finder.reserve((640, 480), 800, 40);
    let mut markers = Markers::at(truth.to_vec(), 0.1);
    let mut frame = |specks: usize| {
        markers.centres_px.truncate(truth.len());
        markers.area_px2.truncate(truth.len());
        for _ in 0..specks {
            markers.centres_px.push(DVec2::new(stream.uniform() * 640.0, stream.uniform() * 480.0));
            markers.area_px2.push(1);
        }
        allocations(|| {
            let _ = finder.run_markers(&markers, Some((640, 480)), &mut found);
            let _ = anchor(&found, &markers.centres_px, 25, 25, &truth);
        })
    };
    // Room for rows and columns of specks is made by what is found.
    assert!(frame(40) > 0, "the counter counts");
    assert_eq!((0..40).map(frame).sum::<usize>(), 0);
}

#[test]
fn triangulation_allocates_for_the_first_frame_only() {
    let camera = Camera {
        width_px: 640,
        height_px: 480,
        fx_px: 600.0,
        fy_px: 600.0,
        cx_px: 319.5,
        cy_px: 239.5,
        distortion: [-0.1, 0.02, 0.0, 0.0, 0.0],
    };
    let plates = vec![Layer { thickness_mm: 3.0, index: 1.49 }];
    let layers = Layers { normal: DVec3::Z, gap_mm: 20.0, plates, gel_index: 1.41 };
    let rig = Rig { layers: Some(layers), ..Rig::parallel(camera, 10.0) };
    let rest: Vec<DVec3> =
        (0..625).map(|i| DVec3::new(0.4 * f64::from(i % 25), 0.4 * f64::from(i / 25) - 5.0, 28.0)).collect();
    let (left, right): (Vec<_>, Vec<_>) = rest.iter().map(|&p| rig.project(p).unwrap()).unzip();
    let covariance_px2 = vec![[[1e-3, 0.0], [0.0, 1e-3]]; rest.len()];
    let centres = |positions_px| Centres { positions_px, covariance_px2: &covariance_px2 };
    for method in [TriangulateMethod::Q, TriangulateMethod::Polynomial, TriangulateMethod::Rays] {
        let params = TriangulateParams { method, ..Default::default() };
        let (mut stage, mut out) = (Triangulator::new(&rig, &params).unwrap(), Vec::new());
        stage.fit_map(&rest);
        let mut run = || stage.run(centres(&left), centres(&right), &mut out).unwrap();
        assert!(allocations(&mut run) > 0, "the counter counts");
        assert_eq!(allocations(&mut run), 0, "{method:?}");
    }
}
