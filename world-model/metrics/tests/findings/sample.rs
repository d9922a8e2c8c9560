//! Made-up findings, drawn from sines: sample data, not a measurement.

use std::collections::BTreeMap;

use serde_json::json;
use wm_metrics::findings::{
    Better, CardDetails, Curve, Header, Metric, ModelFindings, Picture, Section, Series, Suite,
    TextTable, Trajectories,
};
use wm_metrics::statistics::{Bootstrap, bootstrap_mean};

pub const TITLE: &str = "Sample data, not a measurement";

/// A picture of 96 x 32: three squares.
const PNG: &str = include_str!("picture.txt");

const UNITS: i32 = 20;

pub fn findings(model: &str, variant: u64) -> ModelFindings {
    ModelFindings {
        header: Header {
            model: model.to_owned(),
            hash: ["3fa9c1", "b07e52", "6d148a"][variant as usize % 3].repeat(11)[..64].to_owned(),
            space: ["sd3-vae", "v-jepa-2.1", "v-jepa-2.1/svae-96"][variant as usize % 3].to_owned(),
            data: vec![
                "sample/bridge_v2_test".to_owned(),
                "sample/soar_test".to_owned(),
            ],
            data_digest: "5ac1d3".repeat(11)[..64].to_owned(),
            episodes: 20,
            left_out: vec!["sample/bridge_v2_test/17: it has no actions".to_owned()],
            seed: 7,
            settings: json!({
                "solver": {"kind": "euler", "steps": 8},
                "history": 2,
                "horizons": [1, 4],
                "cem": {"samples": 64, "iterations": 5, "elites": 8},
            }),
            sampler: json!({"steps": 8, "shift": 1.0, "context_tau": 0.01}),
            readers: [("success".to_owned(), "9b2f".repeat(16))].into(),
            version: "0.1.0".to_owned(),
        },
        sections: vec![
            fidelity(variant),
            control(variant),
            latents(variant),
            policy(variant),
            robustness(variant),
            cost(variant),
        ],
    }
}

/// A mean over units, each near `middle`, with its bootstrap interval; models differ by `step`.
fn measured(
    variant: u64,
    middle: f64,
    step: f64,
    spread: f64,
    better: Better,
    about: &str,
) -> Metric {
    let phase = middle * 7.0;
    let samples: BTreeMap<String, f64> = (0..UNITS)
        .map(|unit| {
            let shared = (f64::from(unit) * 2.3 + phase).sin() * spread;
            let own = (f64::from(unit) * 5.1 + phase + variant as f64 * 1.7).cos() * spread * 0.4;
            let value = middle + step * variant as f64 + shared + own;
            (format!("episode_{unit:02}"), value)
        })
        .collect();
    let values: Vec<f64> = samples.values().copied().collect();
    let estimate = bootstrap_mean(
        &values,
        &Bootstrap {
            resamples: 1000,
            ..Bootstrap::default()
        },
    )
    .unwrap();
    Metric {
        interval: Some(estimate.interval),
        samples,
        ..Metric::plain(estimate.value, values.len(), better, about)
    }
}

fn line(name: &str, points: usize, band: bool, value: impl Fn(f64) -> f64) -> Series {
    let points: Vec<[f64; 2]> = (1..=points).map(|x| [x as f64, value(x as f64)]).collect();
    let around = |[x, y]: &[f64; 2]| [y * (0.98 - 0.004 * x), y * (1.02 + 0.004 * x)];
    Series {
        name: name.to_owned(),
        band: if band {
            points.iter().map(around).collect()
        } else {
            Vec::new()
        },
        points,
    }
}

fn fidelity(variant: u64) -> Section {
    let v = variant as f64;
    let mut section = Section::new(Suite::Fidelity);
    section.metric(
        "psnr",
        measured(
            variant,
            24.3,
            0.4,
            1.2,
            Better::Higher,
            "How near decoded predictions are to the frames that came, in all pixels.",
        )
        .in_unit("dB"),
    );
    section.metric(
        "ssim",
        measured(
            variant,
            0.81,
            0.012,
            0.04,
            Better::Higher,
            "How alike the structure of decoded predictions and frames is.",
        ),
    );
    section.metric(
        "lpips",
        measured(
            variant,
            0.142,
            -0.009,
            0.02,
            Better::Lower,
            "How far apart they are in the features of a network that sees as people do.",
        ),
    );
    section.metric("fvd", Metric::plain(212.4 - 31.0 * v, 160, Better::Lower, "Fréchet distance of videos: of all clips at once, so that it has no value per episode."));
    section.metric(
        "dynamic_degree",
        measured(
            variant,
            0.34,
            0.001,
            0.1,
            Better::Neither,
            "How much moves.",
        ),
    );
    section.metric(
        "not_a_number",
        Metric::plain(
            f64::NAN,
            0,
            Better::Lower,
            "A sample of a figure that is not finite.",
        ),
    );
    section.absent(
        "aesthetic_quality",
        "needs the weights of the aesthetic predictor: give --aesthetic FILE",
    );
    section.notes.push("Frames were compared at 256 by 256 pixels, after decoding both the prediction and the encoded frame.".to_owned());
    section.curves.push(Curve {
        title: "SSIM over imagined frames".to_owned(),
        x: "imagined frame".to_owned(),
        y: "SSIM".to_owned(),
        series: vec![
            line("rollout", 16, true, |x| 0.9 - (0.019 - 0.003 * v) * x),
            line("last frame repeated", 16, false, |x| 0.86 - 0.026 * x),
        ],
    });
    section.curves.push(Curve {
        title: "PSNR over imagined frames".to_owned(),
        x: "imagined frame".to_owned(),
        y: "PSNR (dB)".to_owned(),
        series: vec![line("rollout", 16, true, |x| 27.0 - (0.45 - 0.06 * v) * x)],
    });
    section.pictures.push(Picture {
        caption: "Sample: above what came, below what was predicted, every fourth frame".to_owned(),
        png: PNG.trim().to_owned(),
    });
    section
}

fn control(variant: u64) -> Section {
    let v = variant as f64;
    let mut section = Section::new(Suite::Control);
    section.metric("cem_k1_error", measured(variant, 0.111, -0.011, 0.02, Better::Lower, "Distance of the action that planning finds from the one that was taken, one step ahead."));
    section.metric(
        "cem_k4_error",
        measured(
            variant,
            0.612,
            -0.06,
            0.09,
            Better::Lower,
            "The same, four steps ahead.",
        ),
    );
    section.metric("ratio_k1", measured(variant, 0.62, -0.002, 0.1, Better::Lower, "Error of a prediction over that of repeating the last latent; below 1, the model knows more than that."));
    section.metric(
        "response_gripper",
        measured(
            variant,
            0.03,
            0.0004,
            0.01,
            Better::Higher,
            "How much latents change with the gripper alone.",
        ),
    );
    section.curves.push(Curve {
        title: "Error of planned actions over the horizon".to_owned(),
        x: "steps ahead (k)".to_owned(),
        y: "L2 error of normalised actions".to_owned(),
        series: vec![Series {
            name: "CEM".to_owned(),
            points: [1.0, 2.0, 4.0, 8.0]
                .map(|k: f64| [k, 0.13 * k.powf(0.9) - 0.012 * v * k])
                .to_vec(),
            band: Vec::new(),
        }],
    });
    let paths = |bend: f64| -> Vec<Vec<[f64; 2]>> {
        (0..10)
            .map(|episode| {
                let turn = f64::from(episode) * 0.63;
                (0..30)
                    .map(|step| {
                        let along = f64::from(step) * 0.008;
                        let across = (along * 14.0 + turn).sin() * 0.03 * bend;
                        [
                            0.2 + along * turn.cos() - across * turn.sin(),
                            along * turn.sin() + across * turn.cos(),
                        ]
                    })
                    .collect()
            })
            .collect()
    };
    section.trajectories.push(Trajectories {
        title: "Planned paths of the gripper (m)".to_owned(),
        caption: "Seen from above: x forwards, y to the left, of the first ten episodes."
            .to_owned(),
        paths: paths(1.0 + 0.5 * v),
    });
    section
}

fn latents(variant: u64) -> Section {
    let mut section = Section::new(Suite::Latents);
    section.metric(
        "idm_pearson_k1",
        measured(
            variant,
            0.507,
            0.13,
            0.03,
            Better::Higher,
            "Correlation of actions read from predicted latents with those taken.",
        ),
    );
    section.metric(
        "balanced_accuracy",
        measured(
            variant,
            0.716,
            0.03,
            0.06,
            Better::Higher,
            "Of a probe that tells success from predicted latents.",
        ),
    );
    section.absent(
        "auc",
        "needs both classes in the test data; all 20 episodes succeed",
    );
    section.tables.push(TextTable {
        title: "Correlation of each action dimension".to_owned(),
        header: ["dimension", "encoder", "world model", "n"]
            .map(str::to_owned)
            .to_vec(),
        rows: ["x", "y", "z", "roll", "pitch", "yaw", "gripper"]
            .iter()
            .enumerate()
            .map(|(i, name)| {
                let r = 0.9 - 0.06 * i as f64;
                vec![
                    (*name).to_owned(),
                    format!("{r:.3}"),
                    format!("{:.3}", r - 0.05 + 0.01 * variant as f64),
                    "480".to_owned(),
                ]
            })
            .collect(),
    });
    section
}

fn policy(variant: u64) -> Section {
    let mut section = Section::new(Suite::Policy);
    section.metric(
        "consensus_success_rate",
        measured(
            variant,
            0.169,
            0.09,
            0.12,
            Better::Higher,
            "Share of imagined trials that both judges call a success.",
        ),
    );
    section.metric(
        "borda_rank",
        Metric::plain(
            25.0 - 9.0 * variant as f64,
            20,
            Better::Lower,
            "Sum of the places that judges give the model.",
        ),
    );
    if variant == 1 {
        section.metric(
            "ood_success_rate",
            measured(
                variant,
                0.303,
                0.05,
                0.1,
                Better::Higher,
                "The same with a distracting object, or other words.",
            ),
        );
    } else {
        section.absent(
            "ood_success_rate",
            "needs pictures with distracting objects: give --ood FOLDER",
        );
    }
    section
}

fn robustness(variant: u64) -> Section {
    let v = variant as f64;
    let mut section = Section::new(Suite::Robustness);
    section.metric(
        "auroc_of_surprise",
        measured(
            variant,
            0.74,
            0.04,
            0.08,
            Better::Higher,
            "How well the model's own surprise tells frames that it has not seen the like of.",
        ),
    );
    section.metric(
        "tiny_change",
        Metric::plain(
            3.2e-5 * (1.0 + v),
            20,
            Better::Lower,
            "Change of latents under noise of one grey level.",
        ),
    );
    section.curves.push(Curve {
        title: "Error under noise, a long series".to_owned(),
        x: "sample".to_owned(),
        y: "latent error".to_owned(),
        series: (0..3)
            .map(|k| {
                line(["brightness", "blur", "shift"][k], 2000, false, move |x| {
                    1.0 + 0.3 * k as f64
                        + 0.1 * v
                        + (x / 90.0 + k as f64).sin() * 0.2
                        + (x * 1.7).sin() * 0.03
                })
            })
            .collect(),
    });
    section
}

fn cost(variant: u64) -> Section {
    let mut section = Section::new(Suite::Cost);
    section.metric(
        "parameters",
        Metric::plain(
            33_123_456.0 + 1e6 * variant as f64,
            1,
            Better::Lower,
            "Of the transition, without encoder and decoder.",
        ),
    );
    section.metric(
        "step_p50",
        Metric::plain(
            12.4 + variant as f64,
            200,
            Better::Lower,
            "Time of a predicted frame.",
        )
        .in_unit("ms"),
    );
    section.metric(
        "memory_peak",
        Metric::plain(812.0, 1, Better::Lower, "At most, while predicting.").in_unit("MiB"),
    );
    section
}

#[allow(dead_code)]
pub fn about() -> CardDetails {
    CardDetails {
        name: "sample-a".to_owned(),
        data: vec!["Bridge V2, 60 000 episodes (CC BY 4.0); sample text".to_owned()],
        recipe: vec![
            ("steps".to_owned(), "100 000".to_owned()),
            ("batch | accumulated".to_owned(), "64".to_owned()),
        ],
        notes: vec!["At most 45 steps of 20 episodes.".to_owned()],
        limits: vec!["One camera, 256 by 256 pixels.".to_owned()],
        uses_refused: vec!["Near people.".to_owned()],
        commands: vec![
            "wm train recipe.yaml".to_owned(),
            "wm evaluate sample-a --seed 7".to_owned(),
        ],
    }
}
