use rand::Rng as _;

use super::{Bootstrap, Estimate, bootstrap::resample};
use crate::{
    MetricError,
    error::{finite, mean},
};

/// Percentile bootstrap in two stages: as many tasks as there are are drawn, then of each drawn task as many trials as it
/// has. Trials of one task are alike, so that drawing trials alone makes intervals too narrow.
///
/// `trials` holds the number of trials of each task. `statistic` is given the drawn tasks, each with the numbers of the
/// trials drawn of it; a task drawn twice is there twice. For the value itself, every task and trial comes once and in
/// order.
///
/// # Errors
/// [`MetricError::Empty`] without a task, or where one has no trial; those of
/// [`bootstrap`](super::bootstrap()).
pub fn bootstrap_clustered(
    trials: &[usize],
    settings: &Bootstrap,
    statistic: impl Fn(&[(usize, Vec<usize>)]) -> f64 + Sync,
) -> Result<Estimate, MetricError> {
    if trials.is_empty() || trials.contains(&0) {
        return Err(MetricError::Empty);
    }
    let tasks = trials.iter().enumerate();
    let own: Vec<_> = tasks
        .map(|(task, count)| (task, (0..*count).collect()))
        .collect();
    resample(settings, statistic(&own), |random| {
        let drawn: Vec<(usize, Vec<usize>)> = (0..trials.len())
            .map(|_| {
                let task = random.random_range(0..trials.len());
                let count = trials.get(task).copied().unwrap_or(0);
                let drawn = (0..count).map(|_| random.random_range(0..count));
                (task, drawn.collect())
            })
            .collect();
        statistic(&drawn)
    })
}

/// [`bootstrap_clustered`] of the mean over tasks of the mean over a task's trials: tasks count alike, whatever their
/// trials.
///
/// # Errors
/// As [`bootstrap_clustered`]; [`MetricError::NotFinite`] of the values.
pub fn bootstrap_clustered_mean<T: AsRef<[f64]> + Sync>(
    tasks: &[T],
    settings: &Bootstrap,
) -> Result<Estimate, MetricError> {
    let trials: Vec<usize> = tasks.iter().map(|task| task.as_ref().len()).collect();
    finite("values", tasks.iter().flat_map(AsRef::as_ref).copied())?;
    bootstrap_clustered(&trials, settings, |drawn| {
        let means: Vec<f64> = drawn
            .iter()
            .filter_map(|(task, trials)| {
                let values = tasks.get(*task)?.as_ref();
                let drawn = trials.iter().filter_map(|trial| values.get(*trial));
                Some(drawn.sum::<f64>() / trials.len() as f64)
            })
            .collect();
        mean(&means)
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{super::bootstrap_mean, *};

    #[test]
    fn tasks_that_differ_widen_the_interval() {
        // Half of the tasks always succeed, half never: trials tell nothing, tasks all.
        let tasks: Vec<[f64; 8]> = (0..20).map(|task| [f64::from(task % 2); 8]).collect();
        let settings = Bootstrap::default();
        let clustered = bootstrap_clustered_mean(&tasks, &settings).unwrap();
        let trials = bootstrap_mean(&tasks.concat(), &settings).unwrap();
        assert_eq!((clustered.value, trials.value), (0.5, 0.5));
        assert!((clustered.standard_error - (0.25_f64 / 20.0).sqrt()).abs() < 0.003);
        assert!((trials.standard_error - (0.25_f64 / 160.0).sqrt()).abs() < 0.001);
    }

    #[test]
    fn a_task_counts_once_whatever_its_trials() {
        let tasks = [vec![1.0], vec![0.0; 9]];
        let found = bootstrap_clustered_mean(&tasks, &Bootstrap::default()).unwrap();
        assert_eq!(found.value, 0.5);
        let empty = bootstrap_clustered_mean(&[vec![1.0], vec![]], &Bootstrap::default());
        assert_eq!(empty, Err(MetricError::Empty));
    }
}
