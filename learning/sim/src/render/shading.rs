//! Draws parts to a picture.

use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::Vector3;

use super::camera::{Camera, IMAGE_SIZE, Light, Projection, SHADOW_SIZE};
use super::{Part, Pattern, linear, raster};

/// Samples along each side of a pixel.
const SAMPLES: usize = 2;
const SIZE: usize = IMAGE_SIZE as usize;
const SAMPLED: usize = SIZE * SAMPLES;
/// Entries of the table from linear light to sRGB bytes: dark steps are below half a byte.
const TONES: usize = 8192;
/// Shares of key light and ambient light.
const KEY: f32 = 0.78;
const AMBIENT: f32 = 0.36;
/// Side of a block of the shadow map, cells, and blocks along the map.
const BLOCK: usize = 16;
const BLOCKS: usize = SHADOW_SIZE.div_ceil(BLOCK);
/// Tolerance of the shadow map, metres: larger than one cell.
const SHADOW_BIAS_M: f32 = 0.005;

/// Colours and light of an episode's room.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// Colour of the table, sRGB 0 to 1.
    pub table_srgb: [f32; 3],
    /// Colour of the floor behind the table, sRGB 0 to 1.
    pub floor_srgb: [f32; 3],
    /// The table's pattern.
    pub pattern: Pattern,
    /// Colour of the light, linear, about 1.
    pub light: [f32; 3],
    /// Direction towards the light.
    pub light_direction: [f32; 3],
    /// Strength of the ambient light, about 1.
    pub ambient: f32,
}

#[cfg(test)]
impl Surroundings {
    pub(crate) fn plain() -> Self {
        Self {
            table_srgb: [0.7, 0.7, 0.65],
            floor_srgb: [0.3, 0.3, 0.4],
            pattern: Pattern::PLAIN,
            light: [1.0; 3],
            light_direction: [0.2, -0.2, 1.0],
            ambient: 1.0,
        }
    }
}

/// A rendered frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// The picture.
    pub rgb: RgbImage,
    /// For each pixel, the mask value of most samples; if requested.
    pub mask: Option<GrayImage>,
}

#[derive(Clone, Copy)]
struct Sample {
    nearness: f32,
    normal: [f32; 3],
    /// Index of the part plus one; 0 for the backdrop.
    part: u16,
}

const EMPTY: Sample = Sample {
    nearness: 0.0,
    normal: [0.0; 3],
    part: 0,
};

/// The backdrop of a pixel.
#[derive(Clone, Copy)]
struct Backdrop {
    /// Intersection of its ray with the table's plane.
    on_table: Vector3<f32>,
    /// Share of the pixel that the table covers; the rest is floor.
    table: f32,
    /// Brightness of the table's pattern, averaged over the pixel.
    tone: f32,
    /// Vignette: brightness falls away from the middle of the table.
    falloff: f32,
}

/// Renders frames of one episode and reuses its buffers.
#[derive(Clone)]
pub struct Renderer {
    camera: Camera,
    light: Light,
    light_colour: [f32; 3],
    ambient: f32,
    table: [f32; 3],
    floor: [f32; 3],
    samples: Vec<Sample>,
    shadow: Vec<f32>,
    /// The greatest height in each block of the shadow map.
    blocks: Vec<f32>,
    backdrop: Vec<Backdrop>,
    tones: Vec<u8>,
}

/// Edges of the table in the base frame, metres: smallest and largest x, then y.
const TABLE: [f32; 4] = [-0.30, 0.72, -0.60, 0.40];

impl Renderer {
    /// A renderer for the given surroundings and camera.
    pub fn new(surroundings: &Surroundings, camera: Camera) -> Self {
        let backdrop = (0..SIZE * SIZE)
            .map(|index| backdrop_at(&camera, &surroundings.pattern, index % SIZE, index / SIZE))
            .collect();
        let tones = (0..=TONES)
            .map(|i| {
                let value = (i as f32 / TONES as f32).powf(1.0 / 2.2);
                (value * 255.0 + 0.5) as u8
            })
            .collect();
        Self {
            camera,
            light: Light::new(Vector3::from(surroundings.light_direction)),
            light_colour: surroundings.light,
            ambient: AMBIENT * surroundings.ambient,
            table: linear(surroundings.table_srgb),
            floor: linear(surroundings.floor_srgb),
            samples: vec![EMPTY; SAMPLED * SAMPLED],
            shadow: vec![f32::MIN; SHADOW_SIZE * SHADOW_SIZE],
            blocks: vec![f32::MIN; BLOCKS * BLOCKS],
            backdrop,
            tones,
        }
    }

    /// Draws the parts.
    pub fn render(&mut self, parts: &[Part], with_mask: bool) -> Picture {
        self.samples.fill(EMPTY);
        self.shadow.fill(f32::MIN);
        self.blocks.fill(f32::MIN);
        for (index, part) in parts.iter().enumerate() {
            // Fits: scenes have some tens of parts.
            self.draw(part, index as u16 + 1);
        }
        self.shade(parts, with_mask)
    }

    fn draw(&mut self, part: &Part, number: u16) {
        let to_world: Vec<_> = part
            .mesh
            .vertices
            .iter()
            .map(|vertex| {
                let position = part.pose.rotation * vertex.position + part.pose.translation.vector;
                let seen = self
                    .camera
                    .project(&position)
                    .map(|[x, y, nearness]| [x * SAMPLES as f32, y * SAMPLES as f32, nearness]);
                let lit = self.light.project(&position);
                (part.pose.rotation * vertex.normal, seen, lit)
            })
            .collect();
        for corners in &part.mesh.triangles {
            let [a, b, c] = corners.map(|corner| to_world.get(corner as usize));
            let (Some(a), Some(b), Some(c)) = (a, b, c) else {
                continue;
            };
            if let (Some(seen_a), Some(seen_b), Some(seen_c)) = (a.1, b.1, c.1) {
                let samples = &mut self.samples;
                raster::fill(
                    (SAMPLED, SAMPLED),
                    [seen_a, seen_b, seen_c],
                    true,
                    |index, weights, nearness| {
                        if let Some(sample) = samples.get_mut(index)
                            && nearness > sample.nearness
                        {
                            let normal = a.0 * weights[0] + b.0 * weights[1] + c.0 * weights[2];
                            *sample = Sample {
                                nearness,
                                normal: normal.into(),
                                part: number,
                            };
                        }
                    },
                );
            }
            if let (Some(lit_a), Some(lit_b), Some(lit_c)) = (a.2, b.2, c.2) {
                let (shadow, blocks) = (&mut self.shadow, &mut self.blocks);
                raster::fill(
                    (SHADOW_SIZE, SHADOW_SIZE),
                    [lit_a, lit_b, lit_c],
                    false,
                    |index, _, height| {
                        if let Some(cell) = shadow.get_mut(index) {
                            *cell = cell.max(height);
                        }
                        let (x, y) = (index % SHADOW_SIZE, index / SHADOW_SIZE);
                        if let Some(block) = blocks.get_mut(y / BLOCK * BLOCKS + x / BLOCK) {
                            *block = block.max(height);
                        }
                    },
                );
            }
        }
    }

    /// Share of the key light that reaches a point, averaged over `radius` cells to each side.
    fn light_share(&self, point: &Vector3<f32>, radius: isize) -> f32 {
        let [x, y, height] = self.light.place(point);
        // Bilinear weights, so that the shadow's edge moves smoothly.
        let (x, y) = (x - 0.5, y - 0.5);
        if x < 0.0 || y < 0.0 {
            return 1.0;
        }
        // The cast rounds down (values are positive), and is much faster than `floor`.
        let (x0, y0) = (x as isize, y as isize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let size = SHADOW_SIZE as isize;
        if x0 - radius < 0 || y0 - radius < 0 || x0 + radius + 1 >= size || y0 + radius + 1 >= size
        {
            return 1.0;
        }
        let limit = height + SHADOW_BIAS_M;
        // Fast path: no shadow in the blocks around.
        let block = |at: isize| at as usize / BLOCK;
        let columns = block(x0 - radius)..=block(x0 + radius + 1);
        let unshaded = (block(y0 - radius)..=block(y0 + radius + 1)).all(|row| {
            columns.clone().all(|column| {
                self.blocks
                    .get(row * BLOCKS + column)
                    .is_none_or(|highest| *highest <= limit)
            })
        });
        if unshaded {
            return 1.0;
        }
        let mut lit = 0.0;
        for dy in -radius..=radius + 1 {
            let weight_y = if dy == -radius {
                1.0 - fy
            } else if dy == radius + 1 {
                fy
            } else {
                1.0
            };
            let start = ((y0 + dy) * size + x0 - radius) as usize;
            let length = (2 * radius + 2) as usize;
            let Some(row) = self.shadow.get(start..start + length) else {
                continue;
            };
            let mut sum = 0.0;
            for (i, cell) in row.iter().enumerate() {
                let weight = if i == 0 {
                    1.0 - fx
                } else if i + 1 == length {
                    fx
                } else {
                    1.0
                };
                sum += if *cell <= limit { weight } else { 0.0 };
            }
            lit += weight_y * sum;
        }
        let width = (2 * radius + 1) as f32;
        lit / (width * width)
    }

    fn shade(&self, parts: &[Part], with_mask: bool) -> Picture {
        let mut rgb = RgbImage::new(IMAGE_SIZE, IMAGE_SIZE);
        let mut mask = with_mask.then(|| GrayImage::new(IMAGE_SIZE, IMAGE_SIZE));
        for (index, backdrop) in self.backdrop.iter().enumerate() {
            let (px, py) = (index % SIZE, index / SIZE);
            let mut sum = [0.0_f32; 3];
            let mut empty = 0.0;
            let mut masks = [0_u8; SAMPLES * SAMPLES];
            let four = self.samples_of(px, py);
            if let Some((sample, part)) = one_surface(&four, parts) {
                let ray = self.camera.ray(px as f32 + 0.5, py as f32 + 0.5);
                let all = (SAMPLES * SAMPLES) as f32;
                sum = self.surface(part, &sample, &ray).map(|value| value * all);
                masks = [part.mask; SAMPLES * SAMPLES];
                self.put(&mut rgb, mask.as_mut(), (px, py), sum, &masks);
                continue;
            }
            for (sub, mask) in masks.iter_mut().enumerate() {
                let (x, y) = (px * SAMPLES + sub % SAMPLES, py * SAMPLES + sub / SAMPLES);
                // In range: `sub` counts the samples of a pixel.
                let sample = four.get(sub).copied().unwrap_or(EMPTY);
                let Some(part) = usize::from(sample.part)
                    .checked_sub(1)
                    .and_then(|i| parts.get(i))
                else {
                    empty += 1.0;
                    continue;
                };
                *mask = part.mask;
                let at = |v: usize| (v as f32 + 0.5) / SAMPLES as f32;
                let ray = self.camera.ray(at(x), at(y));
                let colour = self.surface(part, &sample, &ray);
                for (total, value) in sum.iter_mut().zip(colour) {
                    *total += value;
                }
            }
            if empty > 0.0 {
                for (total, value) in sum.iter_mut().zip(self.background(backdrop)) {
                    *total += empty * value;
                }
            }
            self.put(&mut rgb, mask.as_mut(), (px, py), sum, &masks);
        }
        Picture { rgb, mask }
    }

    fn samples_of(&self, px: usize, py: usize) -> [Sample; SAMPLES * SAMPLES] {
        std::array::from_fn(|sub| {
            let (x, y) = (px * SAMPLES + sub % SAMPLES, py * SAMPLES + sub / SAMPLES);
            // In range: pixels are within the picture.
            self.samples.get(y * SAMPLED + x).copied().unwrap_or(EMPTY)
        })
    }

    /// Sets a pixel from the sum of its samples' light and from their mask values.
    fn put(
        &self,
        rgb: &mut RgbImage,
        mask: Option<&mut GrayImage>,
        (px, py): (usize, usize),
        sum: [f32; 3],
        masks: &[u8],
    ) {
        let tone = |value: f32| {
            let share = (value / (SAMPLES * SAMPLES) as f32).clamp(0.0, 1.0);
            self.tones
                .get((share * TONES as f32) as usize)
                .copied()
                // In range: tones are clamped to the table.
                .unwrap_or(u8::MAX)
        };
        rgb.put_pixel(px as u32, py as u32, Rgb(sum.map(tone)));
        if let Some(mask) = mask {
            mask.put_pixel(px as u32, py as u32, Luma([most_frequent(masks)]));
        }
    }

    fn surface(&self, part: &Part, sample: &Sample, ray: &Vector3<f32>) -> [f32; 3] {
        let normal = Vector3::from(sample.normal).normalize();
        let point = self.camera.eye() + ray / sample.nearness;
        let facing = normal.dot(&self.light.towards);
        let mut key = 0.0;
        let mut highlight = 0.0;
        if facing > 0.0 {
            // Offset along the normal, so that a surface does not shade itself.
            let lit = self.light_share(&(point + normal * 0.004), 1);
            key = KEY * facing * lit;
            if part.gloss > 0.0 {
                let half = (self.light.towards - ray.normalize()).normalize();
                highlight = part.gloss * lit * normal.dot(&half).max(0.0).powi(24);
            }
        }
        // Ambient light is brighter from above and a little from the viewer's side, so that faces in the shade differ.
        let ambient = self.ambient * (0.72 + 0.28 * normal.z - 0.22 * normal.y + 0.1 * normal.x);
        let mut colour = [0.0; 3];
        for ((out, albedo), light) in colour.iter_mut().zip(part.albedo).zip(self.light_colour) {
            *out = albedo * (ambient + key * light) + highlight * light;
        }
        colour
    }

    fn background(&self, backdrop: &Backdrop) -> [f32; 3] {
        let up = self.light.towards.z;
        let lit = if backdrop.table > 0.0 {
            self.light_share(&backdrop.on_table, 3)
        } else {
            1.0
        };
        let mut colour = [0.0; 3];
        for (channel, out) in colour.iter_mut().enumerate() {
            // In range: `channel` is below 3, here and below.
            let light = self.light_colour.get(channel).copied().unwrap_or(1.0);
            let of = |albedo: &[f32; 3], lit: f32| {
                albedo.get(channel).copied().unwrap_or(0.0)
                    * (self.ambient + KEY * up * lit * light)
            };
            let table = of(&self.table, lit) * backdrop.falloff * backdrop.tone;
            let floor = of(&self.floor, 1.0) * backdrop.falloff;
            *out = backdrop.table * table + (1.0 - backdrop.table) * floor;
        }
        colour
    }
}

fn backdrop_at(camera: &Camera, pattern: &Pattern, px: usize, py: usize) -> Backdrop {
    let meets = |x: f32, y: f32| {
        let ray = camera.ray(x, y);
        // Rays at or above the horizon meet the plane far away.
        let distance = if ray.z < -1e-3 {
            -camera.eye().z / ray.z
        } else {
            1e3
        };
        camera.eye() + ray * distance
    };
    const ACROSS: usize = 4;
    let (mut inside, mut tone) = (0.0, 0.0);
    for sub in 0..ACROSS * ACROSS {
        let at = |pixel: usize, i: usize| pixel as f32 + (i as f32 + 0.5) / ACROSS as f32;
        let point = meets(at(px, sub % ACROSS), at(py, sub / ACROSS));
        let [x0, x1, y0, y1] = TABLE;
        if (x0..x1).contains(&point.x) && (y0..y1).contains(&point.y) {
            inside += 1.0;
            tone += pattern.at(point.x, point.y);
        }
    }
    let on_table = meets(px as f32 + 0.5, py as f32 + 0.5);
    let from_middle = (on_table - Vector3::new(0.25, 0.0, 0.0)).norm_squared();
    Backdrop {
        tone: if inside > 0.0 { tone / inside } else { 1.0 },
        on_table,
        table: inside / (ACROSS * ACROSS) as f32,
        falloff: 0.72 + 0.28 / (1.0 + 3.0 * from_middle),
    }
}

/// The mean of a pixel's samples, if all show nearly the same surface: then it is shaded once.
fn one_surface<'a>(samples: &[Sample], parts: &'a [Part]) -> Option<(Sample, &'a Part)> {
    let first = samples.first()?;
    let part = parts.get(usize::from(first.part).checked_sub(1)?)?;
    let mut mean = Sample {
        nearness: 0.0,
        normal: [0.0; 3],
        part: first.part,
    };
    let share = 1.0 / samples.len() as f32;
    for sample in samples {
        let alike = |(a, b): (&f32, &f32)| (a - b).abs() < 0.15;
        if sample.part != first.part || !sample.normal.iter().zip(&first.normal).all(alike) {
            return None;
        }
        mean.nearness += share * sample.nearness;
        for (total, value) in mean.normal.iter_mut().zip(sample.normal) {
            *total += share * value;
        }
    }
    Some((mean, part))
}

/// The most frequent value; on a tie the larger one, so that thin objects are not lost.
fn most_frequent(values: &[u8]) -> u8 {
    let count = |value: u8| values.iter().filter(|other| **other == value).count();
    values
        .iter()
        .copied()
        .max_by_key(|value| (count(*value), *value))
        // A pixel has at least one sample.
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::Mesh;
    use super::*;
    use nalgebra::{Isometry3, Point3};
    use std::sync::Arc;

    #[test]
    fn mask_covers_the_visible_part() {
        let part = Part {
            mesh: Arc::new(Mesh::ball(0.04)),
            pose: Isometry3::translation(0.25, 0.0, 0.0),
            albedo: [0.8, 0.0, 0.0],
            gloss: 0.0,
            mask: 7,
        };
        let mut renderer = Renderer::new(&Surroundings::plain(), Camera::beside_the_arm());
        let with = renderer.render(std::slice::from_ref(&part), true);
        let without = renderer.render(&[], true);
        let mask = with.mask.expect("requested");
        let mut covered = 0;
        for (x, y, value) in mask.enumerate_pixels() {
            let [r, g, _] = with.rgb.get_pixel(x, y).0;
            if value.0 == [7] {
                covered += 1;
                let inside = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
                    .iter()
                    .all(|(x, y)| mask.get_pixel(*x, *y).0 == [7]);
                assert!(!inside || r > 2 * g, "red at {x},{y}");
            } else {
                // Outside is the table: lit, in the part's shadow, or a mixed edge.
                assert!(r <= without.rgb.get_pixel(x, y).0[0].saturating_add(40));
            }
        }
        let seen = Camera::beside_the_arm()
            .pixel(&Point3::new(0.25, 0.0, 0.04))
            .expect("in view");
        assert_eq!(mask.get_pixel(seen[0] as u32, seen[1] as u32).0, [7]);
        // A circle of 0.04 m at 0.65 m through a lens of 455 px: about 2500 pixels.
        assert!((1700..3600).contains(&covered), "{covered}");
    }

    #[test]
    fn part_casts_a_shadow_on_the_table() {
        let part = Part {
            mesh: Arc::new(Mesh::cuboid([-0.03, -0.03, 0.1], [0.03, 0.03, 0.15])),
            pose: Isometry3::translation(0.25, 0.0, 0.0),
            albedo: [0.8, 0.0, 0.0],
            gloss: 0.0,
            mask: 2,
        };
        let mut renderer = Renderer::new(&Surroundings::plain(), Camera::beside_the_arm());
        let empty = renderer.render(&[], false);
        let shaded = renderer.render(&[part], true);
        let mask = shaded.mask.expect("requested");
        let darker = mask
            .enumerate_pixels()
            .filter(|(x, y, value)| {
                value.0 == [0]
                    && shaded.rgb.get_pixel(*x, *y).0[0] + 20 < empty.rgb.get_pixel(*x, *y).0[0]
            })
            .count();
        assert!(darker > 200, "{darker}");
    }
}
