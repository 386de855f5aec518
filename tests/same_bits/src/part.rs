//! Parts as meshes, and the templates that registration makes of them.

use crate::{Digests, Outcome};
use alloc::format;
use core::array;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::DVec3;
use gelstereo_core::register::Template;
use gelstereo_core::surface::TriangleMesh;

/// Distance of a template's samples.
const SPACING_MM: f64 = 0.5;

/// A blunt wedge, askew: no turn leaves it as it was.
pub fn wedge() -> Outcome<TriangleMesh> {
    hexahedron([
        [-2.6, -1.6, -1.5],
        [2.4, -1.2, -1.5],
        [-1.8, 1.4, -1.5],
        [2.0, 2.2, -1.5],
        [-3.5, -2.5, 2.0],
        [3.5, -2.5, 2.0],
        [-2.5, 2.5, 2.0],
        [3.0, 3.0, 2.0],
    ])
}

/// A block with square ends.
pub fn block() -> Outcome<TriangleMesh> {
    let side = |bits: usize, axis: usize| if bits >> axis & 1 == 1 { 1.0 } else { -1.0 };
    hexahedron(array::from_fn(|bits| [2.0 * side(bits, 0), 2.0 * side(bits, 1), 3.0 * side(bits, 2)]))
}

/// Of eight corners, x changing fastest and z slowest.
fn hexahedron(corners: [[f64; 3]; 8]) -> Outcome<TriangleMesh> {
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Ok(TriangleMesh::new(corners.map(DVec3::from_array).to_vec(), triangles)?)
}

pub fn template(mesh: &TriangleMesh) -> Outcome<Template> {
    Ok(Template::from_mesh(mesh, SPACING_MM, 1)?)
}

pub fn templates(out: &mut Digests) -> Outcome<()> {
    for (part, mesh) in [("wedge", wedge()?), ("block", block()?)] {
        let mut add = |name: &str, digest: u64| out.push((format!("template/{part}/{name}"), digest));
        let of_mesh = template(&mesh)?;
        add("mesh", of_mesh.digest());
        add("bytes", Digest::new().bytes(&of_mesh.to_bytes()).value());
        add("read_again", Template::from_bytes(&of_mesh.to_bytes())?.digest());
        let symmetries = of_mesh.find_symmetries(0.02);
        add("symmetries", of_mesh.clone().with_symmetries(symmetries).digest());
        let of_points = Template::new(of_mesh.points_mm(), of_mesh.normals(), SPACING_MM)?;
        add("points", of_points.digest());
        add("surfels", of_points.with_surfels().digest());
    }
    Ok(())
}
