//! Findings of the trials.

mod agreement;
mod consensus;
mod rates;
mod tables;

use wm_metrics::findings::{Picture, Section, Suite};

use super::{Condition, ImaginedTrial, JudgeInputs};
use crate::Settings;
use consensus::ConsensusPair;
use rates::Score;

/// Findings of all trials, in the order of the tasks.
#[must_use]
pub fn summarise(trials: &[(String, ImaginedTrial)], settings: &Settings) -> Section {
    let mut section = Section::new(Suite::Policy);
    let trials_only: Vec<&ImaginedTrial> = trials.iter().map(|(_, trial)| trial).collect();
    let agreed = consensus::of(&trials_only, settings);
    let scores = rates::scores(settings, agreed.as_ref());
    rates::add(&mut section, &trials_only, &scores, settings);
    agreement::add(&mut section, &trials_only, settings, agreed.as_ref());
    tables::add(&mut section, &trials_only, &scores);
    say_absent(&mut section, &trials_only, settings);
    say_how(&mut section, &trials_only, settings, agreed.as_ref());
    let shown = trials.iter().filter_map(|(name, trial)| {
        Some(Picture {
            caption: format!(
                "{name}: \"{}\", from the newest observed frame to the last imagined one, evenly spaced{}",
                trial.instruction,
                trial.probe.map_or(String::new(), |p| format!("; success probability {p:.2}"))
            ),
            png: trial.strip.clone()?,
        })
    });
    section.pictures.extend(shown);
    section
}

/// Reports missing figures, and their requirements.
fn say_absent(section: &mut Section, trials: &[&ImaginedTrial], settings: &Settings) {
    let inputs = &settings.policy.inputs;
    if trials.is_empty() {
        section.absent(
            "probe_success",
            "no episode of the data has an instruction (/task/instruction) and is long enough",
        );
        return;
    }
    if trials.iter().all(|trial| trial.probe.is_none()) {
        section.absent(
            "probe_success",
            "the model has no success probe for these instructions; train one with wm train probe",
        );
    }
    match inputs.judges.len() {
        0 => {
            section.absent(
                "consensus_success",
                "no judges; give two vision-language models with --judges FILE (learning/evaluation/judges.yaml)",
            );
            section.absent(
                "interaction_quality",
                "no judges; the first one of --judges FILE fills the rubric",
            );
        }
        1 => section.absent("consensus_success", "one judge, but a consensus needs two"),
        _ => {}
    }
    if inputs.judges.first().is_some_and(JudgeInputs::is_probe) {
        section.absent(
            "interaction_quality",
            "the judges are success probes; the rubric needs a vision-language model",
        );
    }
    let wanted = [
        (
            Condition::OtherInstruction,
            inputs.other_instructions,
            "not requested; use --tasks FILE --ood instruction",
            "no task has another instruction in the tasks file",
        ),
        (
            Condition::OtherFrame,
            inputs.start_images.is_some(),
            "not requested; use --start-images DIR with edited first frames, for example with distractors",
            "no task has another first frame",
        ),
    ];
    for (condition, is_asked, not_asked, none) in wanted {
        if !trials.iter().any(|trial| trial.condition == condition) {
            let why = if is_asked { none } else { not_asked };
            section.absent(&format!("{}success", condition.prefix()), why);
        }
    }
}

/// Remarks on the measurement.
fn say_how(
    section: &mut Section,
    trials: &[&ImaginedTrial],
    settings: &Settings,
    agreed: Option<&ConsensusPair>,
) {
    let own = &settings.policy;
    section.notes.push(format!(
        "Policy: {}. {} model steps from two observed frames, {} trials per task (the paper: OpenVLA-7B, 50 steps, 8 \
         trials of 20 tasks). Intervals resample tasks, then trials.",
        own.inputs.policy, own.steps, own.trials
    ));
    let unread = trials.iter().filter(|trial| trial.probe.is_none()).count();
    if unread < trials.len() {
        let mut note = "The success probe is not a judge of the paper: it was trained on real episodes, and can be fooled by \
                        imagined ones."
            .to_owned();
        if unread > 0 {
            note += &format!(
                " It does not know the instructions of {unread} of {} trials, which count only for the judges.",
                trials.len()
            );
        }
        section.notes.push(note);
    }
    if own.inputs.judges.first().is_some_and(JudgeInputs::is_probe) {
        section.notes.push(
            "The judges are success probes, not the paper's vision-language models. They read the latents of the model that they \
             judge."
                .into(),
        );
    }
    if trials
        .iter()
        .any(|trial| trial.condition == Condition::OtherFrame)
    {
        section.notes.push(
            "Another first frame replaces both observed ones, without motion between them. Its trials are compared with \
             those of the same tasks from the recorded frames."
                .into(),
        );
    }
    let clipped: usize = trials.iter().map(|trial| trial.clipped).sum();
    let values: usize = trials.iter().map(|trial| trial.values).sum();
    if clipped > 0 {
        section.notes.push(format!(
            "{clipped} of {values} values of actions ({:.1} %) were beyond the model's range and \
             there.",
            100.0 * clipped as f64 / values as f64
        ));
    }
    if let Some(why) = agreed.and_then(|agreed| agreed.remark.as_deref()) {
        section.notes.push(why.to_owned());
    }
}

/// Mean of the existing scores, with their number.
fn mean<'a>(
    trials: impl IntoIterator<Item = &'a ImaginedTrial>,
    score: &Score<'_>,
) -> Option<(f64, usize)> {
    let values: Vec<f64> = trials
        .into_iter()
        .filter_map(|trial| (score.of)(trial))
        .collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (!values.is_empty()).then_some((mean, values.len()))
}

#[cfg(test)]
mod tests;
