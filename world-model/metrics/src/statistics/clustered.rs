use rand::Rng as _;

use super::{Bootstrap, Estimate, bootstrap::resample};
use crate::{
    MetricError,
    error::{finite, mean},
};

/// Two-stage percentile bootstrap: draws as many tasks as there are, then from each drawn task as many trials as it
/// has. Trials of one task are alike, so drawing only trials makes intervals too narrow.
///
/// `trials` has the number of trials of each task. `statistic` receives the drawn tasks with their drawn trial indices;
/// a task drawn twice appears twice. For the value itself, every task and trial appears once, in order.
///
/// # Errors
/// [`MetricError::Empty`] without a task, or for a task without trials; those of [`bootstrap`](super::bootstrap()).
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
            .filter_map(|_| {
                let task = random.random_range(0..trials.len());
                let count = *trials.get(task)?;
                let drawn = (0..count).map(|_| random.random_range(0..count));
                Some((task, drawn.collect()))
            })
            .collect();
        statistic(&drawn)
    })
}

/// [`bootstrap_clustered`] of the mean over tasks of each task's mean; tasks have equal weight.
///
/// # Errors
/// Those of [`bootstrap_clustered`]; [`MetricError::NotFinite`] for the values.
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
    fn differing_tasks_widen_the_interval() {
        // Half of the tasks always succeed, half never: only tasks vary.
        let tasks: Vec<[f64; 8]> = (0..20).map(|task| [f64::from(task % 2); 8]).collect();
        let settings = Bootstrap::default();
        let clustered = bootstrap_clustered_mean(&tasks, &settings).unwrap();
        let trials = bootstrap_mean(&tasks.concat(), &settings).unwrap();
        assert_eq!((clustered.value, trials.value), (0.5, 0.5));
        assert!((clustered.standard_error - (0.25_f64 / 20.0).sqrt()).abs() < 0.003);
        assert!((trials.standard_error - (0.25_f64 / 160.0).sqrt()).abs() < 0.001);
    }

    #[test]
    fn tasks_have_equal_weight() {
        let tasks = [vec![1.0], vec![0.0; 9]];
        let found = bootstrap_clustered_mean(&tasks, &Bootstrap::default()).unwrap();
        assert_eq!(found.value, 0.5);
        let empty = bootstrap_clustered_mean(&[vec![1.0], vec![]], &Bootstrap::default());
        assert_eq!(empty, Err(MetricError::Empty));
    }
}
