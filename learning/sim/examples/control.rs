//! Measures the oracle's control, its duration, and the cost of a picture.
//!
//! `cargo run --release -p wm_sim --example control -- [FIRST_SEED [SEEDS [SHEET.png]]]`
//!
//! The sheet has a row for each kind of goal and each of the first seeds: start, three subgoals, goal.

use std::num::NonZeroUsize;
use std::time::Instant;

use image::{RgbImage, imageops};
use wm_sim::{Environment, GoalKind, Variety};

/// Limit of the oracle's actions: 16 s.
const ACTIONS: usize = 80;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut number = |default: u64| arguments.next().map_or(Ok(default), |text| text.parse());
    let (first, seeds) = (number(0)?, number(100)?);
    let sheet = arguments.next();
    let mut rows = Vec::new();
    for kind in GoalKind::ALL {
        let (mut solved, mut actions, mut longest, mut distance_m) = (0, 0, 0, 0.0);
        let (mut making_s, mut pictures_s) = (0.0, 0.0);
        for seed in first..first + seeds {
            let begin = Instant::now();
            let mut environment = Environment::new(kind, seed, &Variety::default())?;
            making_s += begin.elapsed().as_secs_f64();
            if seed < first + 6 && sheet.is_some() {
                rows.push(row(&mut environment));
                println!("{kind} {seed}: {}", environment.instruction());
            }
            let begin = Instant::now();
            environment.picture();
            pictures_s += begin.elapsed().as_secs_f64();
            while !environment.solved() && environment.steps() < ACTIONS {
                let action = environment.oracle();
                environment.step(&action)?;
            }
            if environment.solved() {
                solved += 1;
                actions += environment.steps();
            }
            longest = longest.max(environment.solution().len());
            distance_m += environment
                .goal()
                .target
                .distance_m(&environment.goal().world);
        }
        // Exact: counts are far below 2^53.
        let each = 1.0 / seeds as f64;
        println!(
            "{kind}: {solved} of {seeds} solved after {:.1} actions; longest solution {longest}, \
             off by {:.1} mm at its end; {:.1} ms to make one, {:.1} ms a picture",
            actions as f64 / f64::from(solved),
            distance_m * each * 1e3,
            making_s * each * 1e3,
            pictures_s * each * 1e3,
        );
    }
    if let Some(path) = sheet {
        save(&rows, &path)?;
    }
    Ok(())
}

/// Pictures of the start, three subgoals and the goal.
fn row(environment: &mut Environment) -> Vec<RgbImage> {
    let every = NonZeroUsize::new(environment.solution().len() / 4).unwrap_or(NonZeroUsize::MIN);
    let mut pictures = vec![environment.picture()];
    let subgoals = environment.subgoals(every);
    pictures.extend(subgoals.into_iter().take(3).map(|subgoal| subgoal.picture));
    pictures.push(environment.goal().picture.clone());
    pictures
}

fn save(rows: &[Vec<RgbImage>], path: &str) -> Result<(), image::ImageError> {
    let size = wm_sim::render::IMAGE_SIZE;
    let mut sheet = RgbImage::new(size * 5, size * rows.len() as u32);
    for (y, row) in rows.iter().enumerate() {
        for (x, picture) in row.iter().enumerate() {
            let [left, top] = [x, y].map(|at| i64::from(size) * at as i64);
            imageops::replace(&mut sheet, picture, left, top);
        }
    }
    sheet.save(path)
}
