//! Triangle meshes: boxes and bodies of revolution.

use nalgebra::Vector3;

/// A vertex: position in metres and outward normal.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Position, metres.
    pub position: Vector3<f32>,
    /// Outward unit normal.
    pub normal: Vector3<f32>,
}

/// A closed mesh whose triangles run counter-clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<Vertex>,
    /// Indices of each triangle's vertices.
    pub triangles: Vec<[u32; 3]>,
}

/// A point of a profile that revolves about z: radius and height in metres, and the normal's radial and upward components.
#[derive(Clone, Copy, Debug)]
pub struct ProfilePoint {
    /// Distance from the axis, metres.
    pub radius: f32,
    /// Height, metres.
    pub height: f32,
    /// Radial part of the normal.
    pub normal_out: f32,
    /// Upward part of the normal.
    pub normal_up: f32,
}

/// Facets around a body of revolution: smooth at 256 pixels.
const FACETS: usize = 28;

impl Mesh {
    /// A box between two corners, metres.
    pub fn cuboid(low: [f32; 3], high: [f32; 3]) -> Self {
        let mut mesh = Self::default();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for (end, sign) in [(low, -1.0), (high, 1.0)] {
                let mut normal = Vector3::zeros();
                normal[axis] = sign;
                let corner = |at_u: f32, at_v: f32| {
                    let mut position = Vector3::zeros();
                    position[axis] = end[axis];
                    position[u] = at_u;
                    position[v] = at_v;
                    Vertex { position, normal }
                };
                let mut corners = [
                    corner(low[u], low[v]),
                    corner(high[u], low[v]),
                    corner(high[u], high[v]),
                    corner(low[u], high[v]),
                ];
                if sign < 0.0 {
                    corners.reverse();
                }
                mesh.quad(corners);
            }
        }
        mesh
    }

    fn quad(&mut self, corners: [Vertex; 4]) {
        // Fits: a mesh has at most a few thousand vertices.
        let first = self.vertices.len() as u32;
        self.vertices.extend(corners);
        self.triangles.push([first, first + 1, first + 2]);
        self.triangles.push([first, first + 2, first + 3]);
    }

    /// A body of revolution about z. Each band goes from its lower to its upper profile point, with the
    /// outside to the right of that direction.
    pub fn revolve(bands: &[[ProfilePoint; 2]]) -> Self {
        let mut mesh = Self::default();
        let around = |facet: usize| {
            let angle = std::f32::consts::TAU * (facet % FACETS) as f32 / FACETS as f32;
            angle.sin_cos()
        };
        for [lower, upper] in bands {
            for facet in 0..FACETS {
                let at = |point: &ProfilePoint, (sin, cos): (f32, f32)| Vertex {
                    position: Vector3::new(point.radius * cos, point.radius * sin, point.height),
                    normal: Vector3::new(
                        point.normal_out * cos,
                        point.normal_out * sin,
                        point.normal_up,
                    ),
                };
                let (here, next) = (around(facet), around(facet + 1));
                mesh.quad([
                    at(lower, here),
                    at(lower, next),
                    at(upper, next),
                    at(upper, here),
                ]);
            }
        }
        mesh
    }

    /// A body of revolution with sharp edges: straight bands through `(radius, height)` points, from the middle of the foot up
    /// along the outside.
    pub fn revolve_profile(profile: &[(f32, f32)]) -> Self {
        let bands: Vec<_> = profile
            .windows(2)
            .filter_map(|pair| {
                let [(r0, z0), (r1, z1)] = [*pair.first()?, *pair.last()?];
                let length = (r1 - r0).hypot(z1 - z0);
                let (out, up) = ((z1 - z0) / length, (r0 - r1) / length);
                let point = |radius, height| ProfilePoint {
                    radius,
                    height,
                    normal_out: out,
                    normal_up: up,
                };
                Some([point(r0, z0), point(r1, z1)])
            })
            .collect();
        Self::revolve(&bands)
    }

    /// An upright cylinder with a narrow chamfer, foot at height 0, metres.
    pub fn cylinder(radius: f32, height: f32) -> Self {
        let edge = 0.06 * radius;
        Self::revolve_profile(&[
            (0.0, 0.0),
            (radius, 0.0),
            (radius, height - edge),
            (radius - edge, height),
            (0.0, height),
        ])
    }

    /// A ball that touches height 0, metres.
    pub fn ball(radius: f32) -> Self {
        const RINGS: usize = 16;
        let point = |ring: usize| {
            let angle = std::f32::consts::PI * (ring as f32 / RINGS as f32 - 0.5);
            let (sin, cos) = angle.sin_cos();
            ProfilePoint {
                radius: radius * cos,
                height: radius * (1.0 + sin),
                normal_out: cos,
                normal_up: sin,
            }
        };
        let bands: Vec<_> = (0..RINGS)
            .map(|ring| [point(ring), point(ring + 1)])
            .collect();
        Self::revolve(&bands)
    }

    /// Rotates the mesh so that its z axis becomes y.
    pub fn along_y(mut self) -> Self {
        // A cyclic change of axes keeps the winding.
        for vertex in &mut self.vertices {
            let (p, n) = (vertex.position, vertex.normal);
            vertex.position = Vector3::new(p.y, p.z, p.x);
            vertex.normal = Vector3::new(n.y, n.z, n.x);
        }
        self
    }

    /// Rotates the mesh so that its z axis becomes x.
    pub fn along_x(mut self) -> Self {
        for vertex in &mut self.vertices {
            let (p, n) = (vertex.position, vertex.normal);
            vertex.position = Vector3::new(p.z, p.x, p.y);
            vertex.normal = Vector3::new(n.z, n.x, n.y);
        }
        self
    }

    /// Moves the mesh by an offset in metres.
    pub fn shift(mut self, x: f32, y: f32, z: f32) -> Self {
        for vertex in &mut self.vertices {
            vertex.position += Vector3::new(x, y, z);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Enclosed volume, by the divergence theorem: positive only if triangles face outwards.
    fn volume(mesh: &Mesh) -> f32 {
        let at = |i: u32| mesh.vertices[i as usize].position;
        mesh.triangles
            .iter()
            .map(|[a, b, c]| at(*a).dot(&at(*b).cross(&at(*c))) / 6.0)
            .sum()
    }

    #[test]
    fn meshes_are_closed_and_face_outwards() {
        let cuboid = volume(&Mesh::cuboid([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]));
        assert!((cuboid - 48.0).abs() < 1e-3, "{cuboid}");
        let ball = volume(&Mesh::ball(1.0));
        assert!((ball - 4.19).abs() < 0.15, "{ball}");
        let cylinder = volume(&Mesh::cylinder(1.0, 2.0).along_y());
        assert!(
            (cylinder - std::f32::consts::TAU).abs() < 0.15,
            "{cylinder}"
        );
    }

    #[test]
    fn normals_agree_with_the_winding() {
        for mesh in [
            Mesh::ball(1.0),
            Mesh::cylinder(1.0, 1.0),
            Mesh::cuboid([0.0; 3], [1.0; 3]),
        ] {
            for [a, b, c] in &mesh.triangles {
                let at = |i: &u32| mesh.vertices[*i as usize];
                let (a, b, c) = (at(a), at(b), at(c));
                let face = (b.position - a.position).cross(&(c.position - a.position));
                assert!(face.dot(&(a.normal + b.normal + c.normal)) > -1e-6);
            }
        }
    }
}
