//! Visibility of the hand in a picture of 128 pixels.

use nalgebra::{Matrix3, Vector3};

use super::{GRIPPER_MASK, Scene};
use crate::arm::ToolPose;
use crate::render::{Camera, IMAGE_SIZE, Renderer, Surroundings};
use crate::world::World;

const SIZE: usize = 128;
/// Usual motion over one step of the model (two frames), metres and radians.
const SHIFT_M: f64 = 0.035;
const TURN_RAD: f64 = 0.2;

/// A picture at half size, and the mask of the hand.
struct View {
    rgb: Vec<f64>,
    hand: Vec<bool>,
}

fn view(position: Vector3<f64>, rpy: Vector3<f64>, opening: f64) -> View {
    let world = World::new(Vec::new(), ToolPose { position, rpy }, opening);
    let mut renderer = Renderer::new(&Surroundings::plain(), Camera::beside_the_arm());
    let picture = renderer.render(&Scene::new(&world).parts(&world), true);
    let mask = picture.mask.expect("requested");
    let mut rgb = Vec::with_capacity(3 * SIZE * SIZE);
    let mut hand = Vec::with_capacity(SIZE * SIZE);
    assert_eq!(IMAGE_SIZE as usize, 2 * SIZE);
    for y in 0..SIZE as u32 {
        for x in 0..SIZE as u32 {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * x + dx, 2 * y + dy));
            for channel in 0..3 {
                let value = |(x, y)| f64::from(picture.rgb.get_pixel(x, y).0[channel]);
                rgb.push(four.map(value).iter().sum::<f64>() / 4.0);
            }
            hand.push(
                four.iter()
                    .any(|(x, y)| mask.get_pixel(*x, *y).0 == [GRIPPER_MASK]),
            );
        }
    }
    View { rgb, hand }
}

/// `after` minus `before` inside `mask`.
fn difference(before: &View, after: &View, mask: &[bool]) -> Vec<f64> {
    let pairs = after.rgb.chunks(3).zip(before.rgb.chunks(3));
    mask.iter()
        .zip(pairs)
        .filter(|(inside, _)| **inside)
        .flat_map(|(_, (a, b))| [a[0] - b[0], a[1] - b[1], a[2] - b[2]])
        .collect()
}

fn mean_absolute(values: &[f64]) -> f64 {
    values.iter().map(|v| v.abs()).sum::<f64>() / values.len() as f64
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Share of `change` (root mean square) outside the span of the three `shifts`.
fn unexplained(change: &[f64], shifts: &[Vec<f64>; 3]) -> f64 {
    let gram = Matrix3::from_fn(|i, j| dot(&shifts[i], &shifts[j]));
    let onto = Vector3::from_fn(|i, _| dot(&shifts[i], change));
    let weights = gram.try_inverse().expect("three directions") * onto;
    let residual: Vec<f64> = change
        .iter()
        .enumerate()
        .map(|(at, value)| value - (0..3).map(|i| weights[i] * shifts[i][at]).sum::<f64>())
        .collect();
    (dot(&residual, &residual) / dot(change, change)).sqrt()
}

/// Poses over the workspace and its middle: position, roll pitch yaw, opening.
fn poses() -> Vec<(Vector3<f64>, Vector3<f64>, f64)> {
    [
        ([0.27, 0.0, 0.06], [0.0, 0.0, 0.0], 1.0),
        ([0.27, 0.0, 0.06], [0.0, 0.0, 0.0], 0.0),
        ([0.22, 0.05, 0.08], [0.1, -0.1, 0.5], 1.0),
        ([0.32, -0.06, 0.05], [-0.2, 0.1, -0.5], 0.0),
        ([0.25, -0.08, 0.09], [0.2, 0.2, -0.9], 1.0),
        ([0.30, 0.08, 0.04], [-0.1, -0.2, 0.9], 0.0),
    ]
    .map(|(position, rpy, opening)| (Vector3::from(position), Vector3::from(rpy), opening))
    .to_vec()
}

#[test]
fn turns_and_openings_are_visible_and_distinct() {
    // Changes of the pose (3 shifts, then roll, pitch, yaw) and of the opening.
    let mut shift_size = 0.0;
    let mut sizes = [0.0; 4];
    let mut residuals = [0.0; 4];
    let mut height = 0.0;
    let poses = poses();
    for (position, rpy, opening) in &poses {
        let before = view(*position, *rpy, *opening);
        let rows: Vec<usize> = (0..SIZE * SIZE)
            .filter(|at| before.hand[*at])
            .map(|at| at / SIZE)
            .collect();
        let (top, bottom) = (rows.iter().min(), rows.iter().max());
        height += (bottom.expect("seen") - top.expect("seen")) as f64 / SIZE as f64;
        let mut after = Vec::new();
        for axis in 0..3 {
            let mut moved = *position;
            moved[axis] += SHIFT_M;
            after.push(view(moved, *rpy, *opening));
        }
        for axis in 0..3 {
            let mut turned = *rpy;
            turned[axis] += TURN_RAD;
            after.push(view(*position, turned, *opening));
        }
        after.push(view(*position, *rpy, 1.0 - opening));
        let mask: Vec<bool> = (0..SIZE * SIZE)
            .map(|at| before.hand[at] || after.iter().any(|view| view.hand[at]))
            .collect();
        let changes: Vec<Vec<f64>> = after
            .iter()
            .map(|after| difference(&before, after, &mask))
            .collect();
        let (shifts, others) = changes.split_at(3);
        let shifts: &[Vec<f64>; 3] = shifts.try_into().expect("three");
        shift_size += shifts.iter().map(|c| mean_absolute(c)).sum::<f64>() / 3.0;
        for (kind, change) in others.iter().enumerate() {
            sizes[kind] += mean_absolute(change);
            // Compared with the three other changes that are not shifts: all differ.
            for (other, against) in others.iter().enumerate() {
                if other != kind {
                    let cosine =
                        dot(change, against) / (dot(change, change) * dot(against, against)).sqrt();
                    assert!(cosine.abs() < 0.7, "{kind} looks like {other}: {cosine}");
                }
            }
            residuals[kind] += unexplained(change, shifts) / poses.len() as f64;
        }
    }
    height /= poses.len() as f64;
    println!("height of the hand {height:.2}");
    assert!(height > 0.3, "{height}");
    for (kind, name) in ["roll", "pitch", "yaw", "gripper"].into_iter().enumerate() {
        let share = sizes[kind] / shift_size;
        println!(
            "{name}: {share:.2} of a shift, {:.2} unexplained",
            residuals[kind]
        );
        assert!(share > 0.4, "{name}: {share}");
        assert!(residuals[kind] > 0.6, "{name}: {}", residuals[kind]);
    }
}
