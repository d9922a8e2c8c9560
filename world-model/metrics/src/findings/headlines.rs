//! Which figures stand for a suite at the top of a report.

use crate::findings::Suite;

/// Figures of a suite that are shown at the top, at most.
const SHOWN: usize = 6;

/// The figures that answer a suite's question, the most telling first.
fn telling(suite: Suite) -> &'static [&'static str] {
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

/// The names to be shown, of `names`, each with whether it has an interval: the telling ones in their order; where there
/// are none, those with an interval, then the others, by name.
pub(crate) fn headlines<'a>(
    suite: Suite,
    names: impl IntoIterator<Item = (&'a str, bool)>,
) -> Vec<&'a str> {
    let telling = telling(suite);
    let mut ranked: Vec<(usize, bool, &str)> = names
        .into_iter()
        .map(|(name, sure)| {
            let own = name.split_once('.').map_or(name, |(_, own)| own);
            let place = telling.iter().position(|told| *told == own);
            (place.unwrap_or(telling.len()), !sure, name)
        })
        .collect();
    ranked.sort_unstable();
    if ranked
        .first()
        .is_some_and(|(place, ..)| *place < telling.len())
    {
        ranked.retain(|(place, ..)| *place < telling.len());
    }
    ranked.truncate(SHOWN);
    ranked.into_iter().map(|(.., name)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_telling_ones_come_in_their_order_and_alone() {
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
    fn without_any_those_with_an_interval_come_first() {
        let names = [("fidelity.a", false), ("fidelity.b", true)];
        assert_eq!(
            headlines(Suite::Fidelity, names),
            ["fidelity.b", "fidelity.a"]
        );
    }
}
