//! The room of an episode: table, floor, light and camera.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::render::{Camera, Pattern, PatternKind, Surroundings};
use crate::variety::Variety;

/// Colours of tables, sRGB: wood, laminate, cloth; less saturated than objects.
const TABLES: [[f32; 3]; 7] = [
    [0.74, 0.66, 0.55],
    [0.68, 0.70, 0.70],
    [0.60, 0.66, 0.62],
    [0.72, 0.70, 0.62],
    [0.60, 0.50, 0.42],
    [0.56, 0.60, 0.68],
    [0.80, 0.79, 0.76],
];
/// Colours of the floor behind the table.
const FLOORS: [[f32; 3]; 4] = [
    [0.30, 0.33, 0.38],
    [0.42, 0.40, 0.37],
    [0.26, 0.30, 0.28],
    [0.50, 0.51, 0.53],
];

/// Draws table, floor and light of an episode.
pub fn draw_surroundings(variety: &Variety, rng: &mut ChaCha8Rng) -> Surroundings {
    let brightness = variety.room_brightness.pick_f32(rng);
    let mut tinted = |colours: &[[f32; 3]]| {
        let colour = colours
            .get(rng.random_range(0..colours.len()))
            .copied()
            // The list of colours is not empty.
            .unwrap_or([0.6; 3]);
        colour.map(|v| (v * brightness + variety.room_tint.pick_f32(rng)).clamp(0.0, 1.0))
    };
    let (table_srgb, floor_srgb) = (tinted(&TABLES), tinted(&FLOORS));
    let warmth = variety.light_warmth.pick_f32(rng);
    let strength = variety.light_strength.pick_f32(rng);
    Surroundings {
        table_srgb,
        floor_srgb,
        pattern: draw_pattern(variety, rng),
        light: [1.0, 1.0 - warmth, 1.0 - 2.0 * warmth].map(|v| v * strength),
        light_direction: [
            variety.light_x.pick_f32(rng),
            variety.light_y.pick_f32(rng),
            1.0,
        ],
        ambient: variety.ambient.pick_f32(rng),
    }
}

fn draw_pattern(variety: &Variety, rng: &mut ChaCha8Rng) -> Pattern {
    let kind = if rng.random_bool(variety.plain_share) {
        PatternKind::Plain
    } else {
        match rng.random_range(0..3) {
            0 => PatternKind::Boards,
            1 => PatternKind::Squares,
            _ => PatternKind::Clouds,
        }
    };
    Pattern {
        kind,
        size_m: variety.pattern_size_m.pick_f32(rng),
        contrast: variety.pattern_contrast.pick_f32(rng),
        angle_rad: rng.random_range(0.0..std::f32::consts::PI),
        seed: rng.random(),
    }
}

/// Draws the camera of an episode, near its usual pose.
pub fn draw_camera(variety: &Variety, rng: &mut ChaCha8Rng) -> Camera {
    Camera::beside_the_arm().moved(
        Variety::vector(variety.camera_shift_m, rng),
        Variety::vector(variety.camera_aim_m, rng),
        variety.camera_roll_rad.pick_f32(rng),
    )
}
