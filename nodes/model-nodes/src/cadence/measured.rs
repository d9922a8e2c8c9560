//! How long something takes on this machine.

use std::time::{Duration, Instant};

/// Runs at most.
const RUNS: usize = 5;
/// No further run begins after this time: a start should not wait for a measurement.
const LONG_ENOUGH: Duration = Duration::from_millis(300);
/// After a first run this long another one would tell little more, and take as long.
const LONG: Duration = Duration::from_secs(1);

/// How long `run` takes once everything that it touches is in memory: the shortest of a few runs, since a machine that
/// starts a node starts others too.
///
/// # Errors
/// Those of `run`.
pub fn measured<E>(mut run: impl FnMut() -> Result<(), E>) -> Result<Duration, E> {
    let begin = Instant::now();
    run()?;
    let mut shortest = begin.elapsed();
    if shortest >= LONG {
        return Ok(shortest);
    }
    for _ in 1..RUNS {
        let started = Instant::now();
        run()?;
        shortest = shortest.min(started.elapsed());
        if begin.elapsed() >= LONG_ENOUGH {
            break;
        }
    }
    Ok(shortest)
}
