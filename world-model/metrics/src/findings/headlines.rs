//! The headline figures of a suite in a report.

use crate::findings::Suite;

/// Most headline figures of a suite.
const MAX_HEADLINES: usize = 6;

/// The figures that answer a suite's question, most important first.
fn priorities(suite: Suite) -> &'static [&'static str] {
    match suite {
        Suite::Fidelity => &[
            "psnr",
            "psnr_gap",
            "ssim",
            "ssim_gap",
            "lpips",
            "fid",
            "fvd",
            "psnr_persistence",
        ],
        Suite::Control => &[
            "cem_k1_error",
            "cem_k1_error_from_zero",
            "cem_k1_error_random",
            "ratio_k1",
            "ratio_k1_negated",
            "action_following",
        ],
        Suite::Latents => &[
            "idm_k1_r_real",
            "idm_k1_r_predicted",
            "idm_k4_r_real",
            "idm_k4_r_predicted",
            "success_balanced_accuracy_real",
            "success_balanced_accuracy_predicted",
            "success_drop",
        ],
        Suite::Policy => &[
            "consensus_success",
            "probe_success",
            "interaction_quality",
            "instruction_following",
        ],
        Suite::Robustness => &[
            "ratio_k1_none",
            "ratio_k1_darker",
            "ratio_k1_shifted",
            "ratio_k1_blurred",
            "ratio_k1_dropped",
            "ratio_k1_half_rate",
        ],
        Suite::Cost => &[
            "transition_parameters",
            "transition_gflops",
            "predict_frame_ms",
            "encode_frame_ms",
            "decode_frame_ms",
        ],
    }
}

/// Selects headlines from `names`, each with whether it has an interval: the priorities in order, or without any, those
/// with an interval and then the others, by name.
pub(crate) fn headlines<'a>(
    suite: Suite,
    names: impl IntoIterator<Item = (&'a str, bool)>,
) -> Vec<&'a str> {
    let priorities = priorities(suite);
    let mut ranked: Vec<(usize, bool, &str)> = names
        .into_iter()
        .map(|(name, sure)| {
            let own = name.split_once('.').map_or(name, |(_, own)| own);
            let place = priorities.iter().position(|priority| *priority == own);
            (place.unwrap_or(priorities.len()), !sure, name)
        })
        .collect();
    ranked.sort_unstable();
    if ranked
        .first()
        .is_some_and(|(place, ..)| *place < priorities.len())
    {
        ranked.retain(|(place, ..)| *place < priorities.len());
    }
    ranked.truncate(MAX_HEADLINES);
    ranked.into_iter().map(|(.., name)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn priorities_come_in_order_and_alone() {
        let names = [
            ("control.a", true),
            ("control.cem_k1_error_zero", true),
            ("control.ratio_k1", false),
            ("control.cem_k1_error", true),
        ];
        assert_eq!(
            headlines(Suite::Control, names),
            ["control.cem_k1_error", "control.ratio_k1"]
        );
    }

    #[test]
    fn figures_with_intervals_come_first_without_priorities() {
        let names = [("fidelity.a", false), ("fidelity.b", true)];
        assert_eq!(
            headlines(Suite::Fidelity, names),
            ["fidelity.b", "fidelity.a"]
        );
    }
}
