//! `wm sim` as a separate binary.
//!
//! `cargo run --release -p wm_sim --example make_bags -- --episodes 8 --seed 0 --masks --out DIR`

use clap::Parser;

#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    sim: wm_sim::SimArgs,
}

fn main() -> anyhow::Result<()> {
    Arguments::parse().sim.run()
}
