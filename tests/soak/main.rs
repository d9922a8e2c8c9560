//! The closed loop on the simulated arm for any length of time, with random faults from a seed: frozen cameras, stopped
//! clocks, network cuts, killed and stopped processes, emergency stops. It measures how far the arm is commanded to
//! move, and moves, after each fault.
//!
//! ```text
//! unshare -n bash -c 'ip link set lo up; cargo test --release -p wm_cli --test soak -- --seconds 7200 --seed 7 --output out/soak'
//! ```
//!
//! The separate network namespace (`unshare -n`, as root) is for the cuts, which disable its loopback. `cargo test` without
//! its name skips it. It writes `soak.json` and `soak.md`. Its exit code is 1 if the arm moved longer after a fault than
//! allowed, if losses were not counted, or if memory grew.

#![allow(clippy::unwrap_used, clippy::expect_used)] // a test, whose helpers may fail it

mod balance;
mod fault;
mod middle;
mod report;
mod suite;
mod watch;

use std::{
    path::PathBuf,
    process::ExitCode,
    rc::Rc,
    time::{Duration, Instant},
};

use clap::Parser;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use fault::Kind;
use middle::Middle;
use report::{Report, Round};
use suite::{Arm, Suite, World};
use watch::Watch;

/// Duration of a fault.
const FAULT: Duration = Duration::from_secs(5);
/// How long the suite may take until the arm moves again after a fault.
const READY: Duration = Duration::from_secs(30);
/// A faster arm is moving \[m/s\].
const MOVING: f64 = 0.02;

/// The closed loop with faults.
#[derive(Parser)]
struct Arguments {
    /// For how long faults are injected [s].
    #[arg(long)]
    seconds: u64,
    /// Draws the faults, their times and the tables.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Time from one fault to the next [s].
    #[arg(long, default_value_t = 20)]
    every: u64,
    /// Folder of the report.
    #[arg(long, default_value = "out/soak")]
    output: PathBuf,
    /// ROS domain.
    #[arg(long, default_value_t = 77)]
    domain: u16,
    /// Faults that are not drawn, with commas between them.
    #[arg(long, value_delimiter = ',')]
    without: Vec<Kind>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let tasks = tokio::task::LocalSet::new();
    tasks.block_on(&runtime, run(arguments))
}

async fn run(arguments: Arguments) -> ExitCode {
    std::fs::create_dir_all(&arguments.output).expect("the folder of the report");
    let mut kinds = fault::possible();
    kinds.retain(|kind| !arguments.without.contains(kind));
    assert!(!kinds.is_empty(), "every fault is excluded");
    let mut rng = ChaCha8Rng::seed_from_u64(arguments.seed);
    let arm = Arm::start(arguments.domain);
    let middle = Rc::new(Middle::new(arm.node()));
    let watch = Rc::new(Watch::new());
    middle.spawn(arm.node());
    watch.spawn(arm.node());
    let world = World::new(arm.node());
    let mut suite = Suite::start(arguments.domain, &arguments.output);
    let mut report = Report::new(&arguments.output, arguments.seed);
    let begin = Instant::now();
    let mut left: Vec<Kind> = Vec::new();
    while begin.elapsed() < Duration::from_secs(arguments.seconds) {
        let round_begin = Instant::now();
        watch.begin();
        if left.is_empty() {
            left.clone_from(&kinds);
        }
        // each kind once before any repeats
        let kind = left.swap_remove(rng.random_range(0..left.len()));
        let seed = rng.random_range(0..1_000_000);
        let wait = Duration::from_millis(rng.random_range(100..1_000));
        let mut round = Round::new(kind, begin.elapsed());
        // a process that was stopped and continued ends a moment later
        round.deaths = revive(&mut suite, &watch);
        let ready = tokio::time::timeout(READY, async {
            world.begin(seed).await;
            while watch.speed() < MOVING {
                watch.changed().await;
            }
        });
        if ready.await.is_err() {
            round.problem = Some("the arm did not move before the fault".to_owned());
        } else {
            tokio::time::sleep(wait).await;
            inject(kind, &middle, &watch, &world, &mut suite, &mut round).await;
        }
        round.deaths.extend(revive(&mut suite, &watch));
        println!("{round}");
        report.add(round, begin.elapsed(), &watch, suite.resident());
        let next = round_begin + Duration::from_secs(arguments.every);
        tokio::time::sleep_until(next.into()).await;
    }
    let is_good = report.finish();
    suite.end();
    drop((world, watch, middle));
    arm.end();
    ExitCode::from(u8::from(!is_good))
}

/// Restarts ended processes, and returns their names.
fn revive(suite: &mut Suite, watch: &Watch) -> Vec<&'static str> {
    let dead = suite.revive();
    dead.iter().for_each(|node| watch.restarted(node));
    dead
}

/// Injects a fault, records the arm's motion, and ends the fault.
async fn inject(
    kind: Kind,
    middle: &Middle,
    watch: &Watch,
    world: &World,
    suite: &mut Suite,
    round: &mut Round,
) {
    watch.begin();
    fault::begin(kind, middle, world, suite);
    // the first message of the fault is on its way
    tokio::time::sleep(FAULT).await;
    round.motion = Some(watch.motion(FAULT));
    round.reason = watch.reason();
    fault::end(kind, middle, world, suite);
}
