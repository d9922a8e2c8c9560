#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use wm_sim::{Environment, GoalKind, Variety};
use wm_zoo::ModelFolder;

use super::{
    findings::{Findings, RunInfo},
    performance::Performance,
    scripted::ScriptedPolicy,
    start::{Outcome, Setup, Start},
};
use crate::closed_loop::model::Model;

/// tiny was not trained on it.
const SEED: u64 = 5_000_000;

#[test]
fn names_round_trip_and_others_are_rejected() {
    for policy in ScriptedPolicy::ALL {
        let name = policy.to_string();
        assert_eq!(name.parse::<ScriptedPolicy>().unwrap(), policy);
    }
    assert_eq!(
        "noise-33".parse::<ScriptedPolicy>().unwrap(),
        ScriptedPolicy::Noise(33)
    );
    for wrong in ["noise", "noise-0", "noise--5", "slow-100", "beside-x", ""] {
        let message = wrong.parse::<ScriptedPolicy>().unwrap_err().to_string();
        assert!(
            message.contains(&format!("{wrong:?}")) && message.contains("oracle"),
            "{message}"
        );
    }
}

/// Share of pushes and carries with success.
fn attained(policy: ScriptedPolicy) -> f64 {
    let episodes = [GoalKind::Push, GoalKind::PickPlace]
        .into_iter()
        .flat_map(|kind| (SEED..SEED + 10).map(move |seed| (kind, seed)));
    let attained = episodes.map(|(kind, seed)| {
        let mut environment = Environment::new(kind, seed, &Variety::default()).unwrap();
        let mut performance = Performance::new(policy, &environment, seed);
        for _ in 0..environment.solution().len() * 3 / 2 {
            let command = performance.command(&environment);
            environment.step(&command).unwrap();
        }
        f64::from(u8::from(environment.solved()))
    });
    attained.sum::<f64>() / 20.0
}

#[test]
fn higher_fault_grade_succeeds_less() {
    assert_eq!(attained(ScriptedPolicy::Oracle), 1.0);
    assert_eq!(attained(ScriptedPolicy::Hold), 0.0);
    let falling: [&[ScriptedPolicy]; 4] = [
        &[ScriptedPolicy::Noise(5), ScriptedPolicy::Noise(80)],
        &[
            ScriptedPolicy::Distracted(5),
            ScriptedPolicy::Distracted(70),
        ],
        &[ScriptedPolicy::Beside(5), ScriptedPolicy::Beside(80)],
        &[ScriptedPolicy::Stop(99), ScriptedPolicy::Stop(40)],
    ];
    for grades in falling {
        let rates: Vec<f64> = grades.iter().map(|policy| attained(*policy)).collect();
        assert!(rates[0] > rates[1] + 0.3, "{grades:?}: {rates:?}");
    }
}

#[test]
fn policy_result_does_not_depend_on_other_policies() {
    let folder = ModelFolder::open("tiny").unwrap();
    let model = Model::load(&folder).unwrap();
    let probe = folder.probe().unwrap().unwrap();
    let run = |policies: &[ScriptedPolicy]| {
        let setup = Setup {
            task: GoalKind::Reach,
            policies,
            model: &model,
            probe: &probe,
            patience: 1.5,
        };
        setup.run(SEED).unwrap()
    };
    let both = run(&[ScriptedPolicy::Hold, ScriptedPolicy::Oracle]);
    let alone = run(&[ScriptedPolicy::Oracle]);
    assert_eq!(alone.outcomes[0], both.outcomes[1]);
    assert!(both.steps >= 10 && both.steps + 2 <= probe.max_frames());
    let [hold, oracle] = [both.outcomes[0], both.outcomes[1]];
    assert!(oracle.executed && oracle.followed && !hold.executed && !hold.followed);
    assert!(oracle.seen > hold.seen, "{both:?}");
    assert!(oracle.imagined > hold.imagined, "{both:?}");
}

fn run_info() -> RunInfo {
    RunInfo {
        task: "reach".into(),
        model: "tiny".into(),
        model_hash: "00".into(),
        seed: 1,
        starts: 8,
        patience: 1.5,
    }
}

/// Starts of five policies; the nth reaches the goal in n of four; `imagined` is its probability.
fn starts(imagined: impl Fn(u8) -> f32) -> Vec<Start> {
    let start = |seed: u64| Start {
        seed,
        steps: 10,
        outcomes: (0..5)
            .map(|policy| Outcome {
                executed: seed % 4 < u64::from(policy),
                followed: true,
                distance_m: 0.01,
                seen: 0.5,
                imagined: imagined(policy),
            })
            .collect(),
    };
    (0..8).map(start).collect()
}

#[test]
fn findings_rank_policies() {
    let policies = &ScriptedPolicy::ALL[..5];
    let json = |imagined: fn(u8) -> f32| -> serde_json::Value {
        let found = Findings::of(run_info(), policies, &starts(imagined)).unwrap();
        assert!(found.to_string().contains("none: all policies"), "{found}");
        serde_json::from_str(&found.to_json().unwrap()).unwrap()
    };
    let agreement = |json: &serde_json::Value, score: &str, success: &str| {
        let agreements = json["agreements"].as_array().unwrap().iter();
        let mut found = agreements.filter(|a| a["score"] == score && a["success"] == success);
        found.next().unwrap().clone()
    };
    let line = json(|policy| f32::from(policy) / 8.0);
    let found = agreement(&line, "imagined", "executed");
    assert!(found["pearson"]["value"].as_f64().unwrap() > 1.0 - 1e-9);
    assert!(
        found["pearson"]["interval_of_policies"][0]
            .as_f64()
            .unwrap()
            > 0.9
    );
    let low = found["pearson"]["interval"][0].as_f64().unwrap();
    assert!(
        low > 0.5 && low < 1.0 - 1e-9,
        "starts change the rates: {low}"
    );
    // Between starts the arm's success differs, the probability does not.
    assert_eq!(line["policies"][2]["executed"]["rate"], 0.5);
    assert_eq!(line["policies"][2]["imagined"]["probability"], 0.25);
    assert_eq!(line["policies"][2]["imagined"]["successes"]["rate"], 0.0);
    let same = agreement(&line, "imagined", "followed");
    assert!(same["pearson"].is_null() && same["spearman"].is_null());

    // The order is right, the amount is not.
    let bent = json(|policy| {
        if policy == 4 {
            1.0
        } else {
            f32::from(policy) / 100.0
        }
    });
    let found = agreement(&bent, "imagined", "executed");
    assert!(found["spearman"]["value"].as_f64().unwrap() > 1.0 - 1e-9);
    assert!(found["pearson"]["value"].as_f64().unwrap() < 0.85);
    let wrong = json(|policy| 1.0 - f32::from(policy) / 8.0);
    let found = agreement(&wrong, "imagined", "executed");
    assert!(found["spearman"]["value"].as_f64().unwrap() < -1.0 + 1e-9);
}
