use wm_metrics::classification::closest_raters;

use crate::{Settings, policy::ImaginedTrial};

/// The two judges of the consensus.
pub(super) struct ConsensusPair {
    pub judges: [String; 2],
    /// How they were chosen among more.
    pub remark: Option<String>,
}

/// The only two judges, or the closest two of more over trials scored by all; `None` for fewer than two.
pub(super) fn of(trials: &[&ImaginedTrial], settings: &Settings) -> Option<ConsensusPair> {
    let names = names(settings);
    let [first, second, others @ ..] = &names[..] else {
        return None;
    };
    let two = |a: &str, b: &str| [a.to_owned(), b.to_owned()];
    if others.is_empty() {
        return Some(ConsensusPair {
            judges: two(first, second),
            remark: None,
        });
    }
    let scored = trials
        .iter()
        .filter(|trial| names.iter().all(|name| trial.success_by(name).is_some()));
    let scored: Vec<&ImaginedTrial> = scored.copied().collect();
    let raters = names
        .iter()
        .map(|name| scored.iter().filter_map(|trial| trial.success_by(name)));
    let raters: Vec<Vec<bool>> = raters.map(Iterator::collect).collect();
    let closest = closest_raters(&raters).ok();
    let chosen = closest.and_then(|c| Some((names.get(c.first)?, names.get(c.second)?, c.kappa)));
    Some(match chosen {
        Some((a, b, kappa)) => ConsensusPair {
            judges: two(a, b),
            remark: Some(format!(
                "The consensus of {} judges is that of {a} and {b}, which agree most: Cohen's kappa {kappa:.3} over the {} \
                 trials scored by all.",
                names.len(),
                scored.len()
            )),
        },
        None => ConsensusPair {
            judges: two(first, second),
            remark: Some(format!(
                "The consensus is that of the first two of {} judges, {first} and {second}: no pair has a kappa to \
                 choose by.",
                names.len()
            )),
        },
    })
}

pub(super) fn names(settings: &Settings) -> Vec<&str> {
    let judges = settings.policy.inputs.judges.iter();
    judges.map(|judge| &*judge.name).collect()
}
