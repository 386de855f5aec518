//! The exact surface of a part against every triangle looked at, and its sign against solid angles.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::solids;

use gelstereo_core::math::DVec3;
use gelstereo_core::math::random::Stream;
use gelstereo_core::surface::{Closest, Facing, Feature, Solid, SolidError, TriangleMesh, Turned};
use proptest::prelude::*;
use solids::{block, distance, squared_distance, star, winding};

const EPS: f64 = f64::EPSILON;

fn mesh((vertices, triangles): (Vec<DVec3>, Vec<[u32; 3]>)) -> TriangleMesh {
    TriangleMesh::new(vertices, triangles).unwrap()
}

fn uniform(random: &mut Stream, low: f64, high: f64) -> DVec3 {
    DVec3::new(random.uniform(), random.uniform(), random.uniform()) * (high - low) + low
}

/// A star-shaped body of 12 n² triangles with radii from 3 to 9 mm.
fn rough(seed: u64, n: usize) -> TriangleMesh {
    let mut random = Stream::new(seed, "radii");
    mesh(star(n, |_, _| 3.0 + 6.0 * random.uniform()))
}

/// Points everywhere, and on and around vertices, edges and faces.
fn queries(mesh: &TriangleMesh, seed: u64, count: usize) -> Vec<DVec3> {
    let mut random = Stream::new(seed, "queries");
    let corners: Vec<[DVec3; 3]> = mesh.corners().collect();
    (0..count)
        .map(|k| {
            let [a, b, c] = corners[(random.uniform() * corners.len() as f64) as usize];
            let (u, v) = (random.uniform(), random.uniform());
            let on = match k % 4 {
                0 => return uniform(&mut random, -15.0, 15.0),
                1 => a,
                2 => a + (b - a) * u,
                _ => a + (b - a) * (u * v) + (c - a) * (u * (1.0 - v)),
            };
            let off = [0.0, 1e-12, 1e-6, 1e-2, 1.0][(random.uniform() * 5.0) as usize];
            on + uniform(&mut random, -off, off)
        })
        .collect()
}

fn transform(mesh: &TriangleMesh, scale: f64, offset: DVec3) -> TriangleMesh {
    let vertices = mesh.vertices_mm().iter().map(|&v| v * scale + offset).collect();
    TriangleMesh::new(vertices, mesh.triangles().to_vec()).unwrap()
}

/// What must hold of any answer by the answer alone.
fn check_consistent(solid: &Solid, mesh: &TriangleMesh, p: DVec3, found: &Closest, size: f64) {
    let rounding = 64.0 * EPS * (size + p.length());
    assert!((found.normal.length() - 1.0).abs() < 8.0 * EPS, "{found:?}");
    assert!((found.point_mm.distance(p) - found.distance_mm.abs()).abs() <= rounding, "{p} {found:?}");
    let corners = mesh.triangles()[found.triangle as usize].map(|i| mesh.vertices_mm()[i as usize]);
    assert!(squared_distance(found.point_mm, corners).sqrt() <= rounding, "{p} {found:?}");
    if found.feature == Feature::Face {
        assert_eq!(found.normal, solid.face_normal(found.triangle));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_nearest_point_is_that_of_all_triangles(seed in any::<u64>(), n in 1_usize..7) {
        let mesh = rough(seed, n);
        let solid = Solid::new(&mesh).unwrap();
        prop_assert!(solid.is_closed());
        for p in queries(&mesh, seed, 200) {
            let found = solid.closest(p);
            check_consistent(&solid, &mesh, p, &found, 9.0);
            // Barycentric coordinates of these triangles lose three digits at most.
            let expected = distance(p, &mesh);
            prop_assert!(
                (found.distance_mm.abs() - expected).abs() <= 1e3 * EPS * 25.0,
                "{} {} {}",
                p,
                found.distance_mm,
                expected
            );
        }
    }

    #[test]
    fn the_sign_is_that_of_the_solid_angle(seed in any::<u64>(), n in 1_usize..6) {
        let mesh = rough(seed, n);
        let solid = Solid::new(&mesh).unwrap();
        for p in queries(&mesh, seed ^ 1, 200) {
            let found = solid.closest(p);
            // Closer than this the solid angles are rounding.
            if found.distance_mm.abs() > 1e-9 {
                prop_assert_eq!(found.distance_mm < 0.0, winding(p, &mesh) > 0.5, "{} {:?}", p, found);
            }
        }
    }

    #[test]
    fn a_first_guess_changes_nothing(seed in any::<u64>(), n in 1_usize..7) {
        let mesh = rough(seed, n);
        let solid = Solid::new(&mesh).unwrap();
        let triangles = mesh.triangles().len() as u32;
        for (k, p) in queries(&mesh, seed ^ 2, 100).into_iter().enumerate() {
            let found = solid.closest(p);
            for guess in [0, k as u32 % triangles, found.triangle, triangles, u32::MAX] {
                prop_assert_eq!(solid.closest_from(p, guess), found);
            }
            let reach = found.distance_mm.abs();
            prop_assert_eq!(solid.closest_within(p, reach, None), Some(found));
            prop_assert_eq!(solid.closest_within(p, reach * 0.999, Some(0)).is_none(), reach > 0.0);
        }
    }

    #[test]
    fn powers_of_two_change_no_digit_and_metres_or_a_million_millimetres_few(seed in any::<u64>()) {
        let base = rough(seed, 4);
        let solid = Solid::new(&base).unwrap();
        let binary = Solid::new(&transform(&base, 1.0 / 1024.0, DVec3::ZERO)).unwrap();
        let metres = Solid::new(&transform(&base, 1e-3, DVec3::ZERO)).unwrap();
        let offset = DVec3::new(1e6, -1e6, 1e6);
        let far = Solid::new(&transform(&base, 1.0, offset)).unwrap();
        for p in queries(&base, seed ^ 3, 100) {
            let found = solid.closest(p);
            let other = binary.closest(p / 1024.0);
            prop_assert_eq!(
                (other.distance_mm * 1024.0, other.triangle, other.normal),
                (found.distance_mm, found.triangle, found.normal)
            );
            // Vertices and the point are rounded anew, and with them the distance by as much.
            let other = metres.closest(p * 1e-3);
            prop_assert!((other.distance_mm * 1e3 - found.distance_mm).abs() <= 1e3 * EPS * 25.0);
            let moved = p + offset;
            let (other, found) = (far.closest(moved), solid.closest(moved - offset));
            prop_assert!((other.distance_mm.abs() - found.distance_mm.abs()).abs() <= 4.0 * EPS * 1e6);
        }
    }

    /// Boxes are kept in single precision, which has fewer powers of two than these.
    #[test]
    fn row_09_every_power_of_two_has_the_same_answer(seed in any::<u64>(), power in -200_i32..36) {
        let base = rough(seed, 3);
        let scale = 2.0_f64.powi(power);
        let (solid, other) =
            (Solid::new(&base).unwrap(), Solid::new(&transform(&base, scale, DVec3::ZERO)).unwrap());
        for p in queries(&base, seed ^ 4, 100) {
            let (here, there) = (solid.closest(p), other.closest(p * scale));
            prop_assert_eq!(
                (there.distance_mm, there.triangle, there.feature),
                (here.distance_mm * scale, here.triangle, here.feature)
            );
        }
    }

    #[test]
    fn points_far_away_have_their_distance_too(seed in any::<u64>(), power in 0_i32..100) {
        let mesh = rough(seed, 3);
        let solid = Solid::new(&mesh).unwrap();
        for p in queries(&mesh, seed ^ 5, 20) {
            let p = p * 10.0_f64.powi(power);
            let (found, expected) = (solid.closest(p).distance_mm.abs(), distance(p, &mesh));
            prop_assert_eq!(solid.closest_from(p, 7), solid.closest(p));
            prop_assert!(
                (found - expected).abs() <= 1e3 * EPS * (25.0 + p.length()),
                "{} {} {}",
                p,
                found,
                expected
            );
        }
    }

    /// Corners on a coarse lattice: triangles repeat, touch, cross, lie in one plane and have no area.
    #[test]
    fn soups_have_a_distance_too(
        numbers in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(0_i8..4)), 1..40),
        points in prop::collection::vec(prop::array::uniform3(-2_i8..12), 20),
    ) {
        let vertices: Vec<DVec3> =
            numbers.iter().flatten().map(|v| DVec3::from_array(v.map(f64::from))).collect();
        let triangles: Vec<[u32; 3]> =
            (0..numbers.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let Ok(mesh) = TriangleMesh::new(vertices, triangles) else { return Ok(()) };
        let solid = Solid::new(&mesh).unwrap();
        for p in points.iter().map(|v| DVec3::from_array(v.map(f64::from)) / 2.0) {
            let found = solid.closest(p);
            check_consistent(&solid, &mesh, p, &found, 4.0);
            let squares: Vec<f64> = mesh
                .corners()
                .enumerate()
                .map(|(t, c)| {
                    if solid.face_normal(t as u32) == DVec3::ZERO {
                        f64::INFINITY
                    } else {
                        squared_distance(p, c)
                    }
                })
                .collect();
            let least = squares.iter().copied().fold(f64::INFINITY, f64::min);
            prop_assert!((found.distance_mm.abs() - least.sqrt()).abs() < 1e-12);
            prop_assert_eq!(solid.closest_from(p, 3), found);
        }
    }
}

#[test]
fn row_12_of_triangles_at_the_same_distance_the_first_one_is_named() {
    // Places and distances are exact in binary; every vertex belongs to several triangles.
    let mesh = mesh(block(DVec3::splat(-4.0), DVec3::splat(4.0), 4));
    let solid = Solid::new(&mesh).unwrap();
    for n in 0..13 * 13 * 13 {
        let p = DVec3::new((n % 13) as f64, (n / 13 % 13) as f64, (n / 169) as f64) - 6.0;
        let found = solid.closest(p);
        let squares: Vec<f64> = mesh.corners().map(|corners| squared_distance(p, corners)).collect();
        let least = squares.iter().copied().fold(f64::INFINITY, f64::min);
        let first = squares.iter().position(|&s| s <= least + 1e-9).unwrap();
        assert_eq!(found.triangle as usize, first, "{p}");
        let outside = (p.abs() - 4.0).max(DVec3::ZERO).length();
        let depth = 4.0 - p.abs().max_element();
        assert_eq!(found.distance_mm, if outside > 0.0 { outside } else { -depth }, "{p}");
    }
}

#[test]
fn a_cube_says_what_its_edges_and_corners_are() {
    let solid = Solid::new(&mesh(block(DVec3::ZERO, DVec3::splat(2.0), 1))).unwrap();
    let corner = solid.closest(DVec3::new(3.0, 3.0, 3.0));
    assert_eq!((corner.feature, corner.point_mm), (Feature::Vertex, DVec3::splat(2.0)));
    assert!((corner.distance_mm - 3.0_f64.sqrt()).abs() < 4.0 * EPS);
    // Weighted by angle, the squares' diagonals do not tilt it, at whichever corners they end.
    for n in 0..8 {
        let out = DVec3::new(f64::from(n % 2), f64::from(n / 2 % 2), f64::from(n / 4)) * 2.0 - 1.0;
        let corner = solid.closest(out * 2.0 + 1.0);
        assert!(corner.normal.distance(out / 3.0_f64.sqrt()) < 4.0 * EPS, "{corner:?}");
    }
    let edge = solid.closest(DVec3::new(3.0, 3.0, 0.7));
    assert_eq!((edge.feature, edge.point_mm), (Feature::Edge, DVec3::new(2.0, 2.0, 0.7)));
    assert!(edge.normal.distance(DVec3::new(1.0, 1.0, 0.0) / 2.0_f64.sqrt()) < 4.0 * EPS);
    let face = solid.closest(DVec3::new(0.5, 0.25, -1.5));
    assert_eq!((face.feature, face.distance_mm, face.normal), (Feature::Face, 1.5, -DVec3::Z));
}

#[test]
fn of_a_thin_plate_the_side_that_is_touched_answers() {
    let solid = Solid::new(&mesh(block(DVec3::ZERO, DVec3::new(20.0, 20.0, 0.4), 5))).unwrap();
    let up = Facing { direction: DVec3::Z, least_cosine: 0.5 };
    for k in 0..50 {
        let p = DVec3::new(7.3, 11.1, 0.9 - 0.05 * f64::from(k));
        let found = solid.closest_facing(p, &up, f64::INFINITY, None).unwrap();
        assert_eq!(found.normal, DVec3::Z);
        assert!((found.distance_mm - (p.z - 0.4)).abs() < 8.0 * EPS);
        let near = solid.closest_facing(p, &up, 0.3, Some(found.triangle));
        assert_eq!(near.is_some(), found.distance_mm.abs() <= 0.3);
    }
    let nowhere = Facing { direction: DVec3::new(0.6, 0.0, 0.8), least_cosine: 0.9 };
    assert_eq!(solid.closest_facing(DVec3::ZERO, &nowhere, f64::INFINITY, None), None);
}

#[test]
fn a_line_first_meets_the_outermost_of_all_faces_that_it_crosses() {
    let mesh = rough(5, 6);
    let solid = Solid::new(&mesh).unwrap();
    let mut random = Stream::new(6, "lines");
    let mut met = [0; 2];
    for _ in 0..2000 {
        let way = uniform(&mut random, -1.0, 1.0).normalize();
        let (p, reach) = (uniform(&mut random, -9.0, 9.0), 6.0 * random.uniform());
        let facing = Facing { direction: way, least_cosine: 0.03 };
        // By Cramer's rule: p - s way = a + u (b - a) + v (c - a), within the triangle.
        let crossings = mesh.corners().filter_map(|[a, b, c]| {
            let normal = (b - a).cross(c - a);
            let volume = normal.dot(way);
            let s = normal.dot(p - a) / volume;
            let q = p - way * s - a;
            let [u, v] = [q.cross(c - a), (b - a).cross(q)].map(|x| x.dot(normal) / normal.length_squared());
            let is_met = u >= 0.0 && v >= 0.0 && u + v <= 1.0 && volume >= 0.03 * normal.length();
            (is_met && s.abs() <= reach).then_some(s)
        });
        let least = crossings.fold(f64::INFINITY, f64::min);
        match solid.first_met(p, &facing, reach) {
            // Distances along a line are those of planes over the cosine.
            Some(found) => assert!((found.distance_mm - least).abs() < 1e3 * EPS / 0.03, "{found:?} {least}"),
            None => assert_eq!(least, f64::INFINITY),
        }
        met[usize::from(least.is_finite())] += 1;
    }
    assert!(met[0] > 200 && met[1] > 200, "{met:?}");
    // A line through an edge, or a vertex, of two faces in one plane meets one of them.
    let plate = Solid::new(&self::mesh(block(DVec3::ZERO, DVec3::new(2.0, 2.0, 1.0), 1))).unwrap();
    let up = Facing { direction: DVec3::Z, least_cosine: 0.03 };
    for k in 0..=20 {
        let x = 0.1 * f64::from(k);
        for p in [DVec3::new(x, x, 1.3), DVec3::new(x, 2.0 - x, 1.3), DVec3::new(x, 0.0, 1.3)] {
            let found = plate.first_met(p, &up, 0.5).unwrap();
            assert!((found.distance_mm - 0.3).abs() < 8.0 * EPS);
        }
    }
    assert_eq!(plate.first_met(DVec3::new(1.0, 1.0, 1.3), &up, 0.2), None);
}

#[test]
fn slivers_keep_all_digits() {
    // A strip of height 1e-9 mm and 10 mm long, between two halves of a square.
    for height in [1e-3, 1e-6, 1e-9, 1e-12, 1e-14] {
        let y = 5.0 + height;
        let places = [(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (0.0, 5.0), (3.0, y), (10.0, 10.0), (0.0, 10.0)];
        let vertices = places.map(|(x, y)| DVec3::new(x, y, 1.0)).to_vec();
        let triangles = vec![[0, 1, 2], [0, 2, 3], [3, 2, 4], [3, 4, 6], [4, 5, 6], [4, 2, 5]];
        let solid = Solid::new(&TriangleMesh::new(vertices, triangles).unwrap()).unwrap();
        let mut random = Stream::new(1, "slivers");
        for _ in 0..500 {
            let p = DVec3::new(10.0 * random.uniform(), 10.0 * random.uniform(), 4.0 * random.uniform());
            let found = solid.closest(p);
            assert!((found.distance_mm - (p.z - 1.0)).abs() < 32.0 * EPS * 10.0, "{height} {p} {found:?}");
            assert!(found.point_mm.distance(DVec3::new(p.x, p.y, 1.0)) < 1e-13, "{height} {p} {found:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Down to heights at which the normal is rounding: found by fuzzing, as a first guess changed the
    /// answer.
    #[test]
    fn of_slivers_of_any_height_the_answer_does_not_depend_on_the_guess(
        seed in any::<u64>(), digits in 3_i32..17,
    ) {
        let mut random = Stream::new(seed, "slivers");
        let mut vertices = Vec::new();
        for _ in 0..6 {
            let (a, b) = (uniform(&mut random, -3.0, 3.0), uniform(&mut random, -3.0, 3.0));
            // Two along one line: equally far but for rounding, so that one wrongly passed over shows.
            for _ in 0..2 {
                let off = uniform(&mut random, -1.0, 1.0) * 10.0_f64.powi(-digits);
                vertices.extend([a, b, a + (b - a) * random.uniform() + off]);
            }
        }
        vertices.extend([DVec3::ZERO, DVec3::X, DVec3::Y]);
        let triangles: Vec<[u32; 3]> = (0..13).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mesh = TriangleMesh::new(vertices, triangles).unwrap();
        let solid = Solid::new(&mesh).unwrap();
        for _ in 0..50 {
            let p = uniform(&mut random, -5.0, 5.0);
            let found = solid.closest(p);
            check_consistent(&solid, &mesh, p, &found, 3.0);
            for guess in 0..13 {
                prop_assert_eq!(solid.closest_from(p, guess), found);
            }
            // Slivers with a face are as far as their longest edge, but for their height.
            let kept =
                mesh.corners().enumerate().filter(|&(t, _)| solid.face_normal(t as u32) != DVec3::ZERO);
            let segment = |a: DVec3, b: DVec3| {
                let share = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
                (a + (b - a) * share).distance(p)
            };
            let square = squared_distance(p, [DVec3::ZERO, DVec3::X, DVec3::Y]).sqrt();
            let least =
                kept.filter(|&(t, _)| t < 12).map(|(_, [a, b, _])| segment(a, b)).fold(square, f64::min);
            prop_assert!((found.distance_mm.abs() - least).abs() < 2.0 * 10.0_f64.powi(-digits) + 1e-14);
        }
    }
}

#[test]
fn triangles_without_an_area_pass_the_normals_on() {
    // The edge of a wedge of 20 degrees, mended along a vertex in its middle by a triangle without an area.
    let (s, c) = 20.0_f64.to_radians().sin_cos();
    let vertices = vec![
        DVec3::new(0.0, 0.0, -8.0),
        DVec3::new(0.0, 0.0, 8.0),
        DVec3::new(0.0, 0.0, 1.0),
        DVec3::new(10.0 * c, 10.0 * s, 0.0),
        DVec3::new(10.0 * c, -10.0 * s, 0.0),
    ];
    // One side sees the edge whole, the other side in two pieces; of both the first one is asked.
    let triangles = vec![[0, 1, 3], [1, 2, 4], [2, 0, 4], [0, 2, 1], [1, 4, 3], [0, 3, 4]];
    for turned in [0, 1] {
        let mut triangles = triangles.clone();
        triangles.rotate_left(turned);
        let mesh = TriangleMesh::new(vertices.clone(), triangles).unwrap();
        let solid = Solid::new(&mesh).unwrap();
        assert_eq!((solid.report().degenerate, solid.is_closed()), (1, true));
        assert!(solid.report().volume_mm3 > 1.0);
        let mut random = Stream::new(1, "wedge");
        for _ in 0..2000 {
            let p = DVec3::new(1.0, 1.0, 6.0) - uniform(&mut random, 0.0, 2.0) * DVec3::new(1.0, 1.0, 6.0);
            let found = solid.closest(p);
            if found.distance_mm.abs() > 1e-6 {
                assert_eq!(found.distance_mm < 0.0, winding(p, &mesh) > 0.5, "{p} {found:?}");
            }
        }
        // At the vertex in the edge's middle both sides count half.
        let middle = solid.closest(vertices[2] - DVec3::X);
        assert!(middle.normal.distance(-DVec3::X) < 16.0 * EPS, "{middle:?}");
    }
}

#[test]
fn the_report_names_holes_and_faces_that_are_inside_out() {
    let (vertices, triangles) = block(DVec3::ZERO, DVec3::splat(3.0), 2);
    let of = |triangles: Vec<[u32; 3]>| *Solid::new(&mesh((vertices.clone(), triangles))).unwrap().report();
    let whole = of(triangles.clone());
    assert!(whole.is_closed() && !whole.is_inside_out() && (whole.volume_mm3 - 27.0).abs() < 1e-12);
    assert_eq!((whole.degenerate, whole.duplicates, whole.crowded_edges), (0, 0, 0));
    let hole = of(triangles[1..].to_vec());
    assert_eq!((hole.boundary_edges, hole.clashing_edges, hole.is_closed()), (3, 0, false));
    let turn = |[a, b, c]: [u32; 3]| [a, c, b];
    let inside_out = of(triangles.iter().map(|&t| turn(t)).collect());
    assert!(inside_out.is_inside_out() && (inside_out.volume_mm3 + 27.0).abs() < 1e-12);
    let mut one = triangles.clone();
    one[7] = turn(one[7]);
    assert_eq!((of(one.clone()).clashing_edges, of(one).is_closed()), (3, false));
    let mut twice = triangles.clone();
    twice.push([triangles[0][1], triangles[0][2], triangles[0][0]]);
    twice.push([triangles[0][1], triangles[0][1], triangles[0][0]]);
    let twice = of(twice);
    assert_eq!((twice.duplicates, twice.degenerate, twice.is_closed(), twice.triangles), (1, 1, true, 50));
}

#[test]
fn faces_are_turned_to_their_majority_and_outward() {
    let (vertices, triangles) = block(DVec3::ZERO, DVec3::splat(3.0), 4);
    let right = TriangleMesh::new(vertices.clone(), triangles.clone()).unwrap();
    let mut random = Stream::new(1, "turned");
    for share in [0.0, 0.05, 0.3, 0.45, 0.7, 1.0] {
        let some =
            triangles.iter().map(|&[a, b, c]| if random.uniform() < share { [a, c, b] } else { [a, b, c] });
        let wrong = TriangleMesh::new(vertices.clone(), some.collect()).unwrap();
        let off = wrong.triangles().iter().zip(&triangles).filter(|(a, b)| a != b).count();
        let (mesh, turned) = wrong.turned_outward();
        assert_eq!(mesh, right, "{share}");
        let inside_out = share > 0.5;
        let stray = if inside_out { triangles.len() - off } else { off };
        assert_eq!(turned, Turned { stray, inside_out });
    }
    // A cavity faces into itself, which is outward from the body.
    let (inner, holes) = block(DVec3::ONE, DVec3::splat(2.0), 1);
    let first = vertices.len() as u32;
    let holes = holes.iter().map(|&[a, b, c]| [first + a, first + c, first + b]);
    let hollow = TriangleMesh::new(
        vertices.iter().copied().chain(inner).collect(),
        triangles.iter().copied().chain(holes).collect(),
    );
    let hollow = hollow.unwrap();
    assert_eq!(hollow.turned_outward(), (hollow.clone(), Turned::default()));
    let solid = Solid::new(&hollow).unwrap();
    assert!((solid.report().volume_mm3 - 26.0).abs() < 1e-12);
    assert_eq!(solid.closest(DVec3::splat(1.5)).distance_mm, 0.5);
}

#[test]
fn what_is_no_surface_or_no_point_is_said() {
    let flat =
        |x: f64| vec![DVec3::new(x, 0.0, 0.0), DVec3::new(x + 1.0, 0.0, 0.0), DVec3::new(x, 1e-5, 0.0)];
    let line = TriangleMesh::new(flat(1e11), vec![[0, 1, 2]]).unwrap();
    assert_eq!(Solid::new(&line).unwrap_err(), SolidError::Empty);
    let far = TriangleMesh::new(flat(1e13), vec![[0, 1, 2]]).unwrap();
    assert_eq!(Solid::new(&far).unwrap_err(), SolidError::TooFar { vertex: 0 });
    let solid = Solid::new(&mesh(block(DVec3::ZERO, DVec3::ONE, 3))).unwrap();
    for x in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e300] {
        let found = solid.closest(DVec3::new(x, 0.5, 0.5));
        assert_eq!(found.distance_mm, f64::INFINITY);
        assert!(found.point_mm.is_finite() && found.normal.is_finite());
        assert_eq!(solid.closest_within(DVec3::splat(x), f64::INFINITY, Some(2)), None);
    }
    assert_eq!(solid.closest_within(DVec3::ZERO, f64::NAN, None), None);
    assert_eq!(solid.closest(DVec3::splat(0.5)).distance_mm, -0.5);
}
