use wm_metrics::findings::{Section, Suite};

use super::Representation;
use crate::Settings;

mod actions;
mod success;
mod trajectories;

/// Findings of all units, in order.
#[must_use]
pub fn summarise(units: &[(String, Representation)], settings: &Settings) -> Section {
    let mut section = Section::new(Suite::Latents);
    let mut told = Vec::new();
    let mut judged = Vec::new();
    let mut followed = Vec::new();
    for (_, unit) in units {
        match unit {
            Representation::Told(found) => told.push(found),
            Representation::Judged(found) => judged.push(found),
            Representation::Features(found) => followed.push(found),
        }
    }
    let models = told.first().map_or(0, |found| found.models.len());
    if models == 0 {
        section.absent(
            "idm_r",
            "the model has no inverse dynamics model (idm.safetensors); train one with wm train idm",
        );
    }
    for model in 0..models {
        actions::of_model(&mut section, &told, settings, model);
        trajectories::of_model(&mut section, &followed, model);
    }
    let probes = judged.first().map_or(0, |found| found.probes.len());
    if probes == 0 {
        section.absent(
            "success_balanced_accuracy_real",
            "needs a success probe (wm train probe), and episodes with an instruction known to it \
             (/task/instruction) and an outcome (/task/success)",
        );
    }
    for probe in 0..probes {
        success::of_probe(&mut section, &judged, settings, probe);
    }
    section
}
