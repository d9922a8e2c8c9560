//! Measures turns of the hand and changes of the gripper over many episodes.
//!
//! `cargo run --release -p wm_sim --example motion -- [FIRST_SEED [EPISODES]]`

use wm_sim::{Episode, EpisodeOptions};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut number = |default: u64| arguments.next().map_or(Ok(default), |text| text.parse());
    let (first, episodes) = (number(0)?, number(20)?);
    let (mut squares, mut frames, mut moving, mut succeeded) = ([0.0_f64; 6], 0, 0, 0);
    for seed in first..first + episodes {
        let episode = Episode::generate(seed, &EpisodeOptions::default())?;
        succeeded += u64::from(episode.success);
        for pair in episode.frames.windows(2) {
            let [before, after] = pair else { continue };
            frames += 1;
            moving += u64::from((after.opening - before.opening).abs() > 0.05);
            for (square, value) in squares.iter_mut().zip(before.action) {
                *square += f64::from(value).powi(2);
            }
        }
    }
    let total = f64::from(frames);
    let names = ["x", "y", "z", "roll", "pitch", "yaw"];
    for (name, square) in names.into_iter().zip(squares) {
        println!(
            "{name}: {:.4} a frame, root mean square",
            (square / total).sqrt()
        );
    }
    println!(
        "the gripper moves in {:.2} of the frames",
        moving as f64 / total
    );
    println!("{succeeded} of {episodes} succeeded");
    Ok(())
}
