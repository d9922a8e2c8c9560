use std::path::PathBuf;

use candle_core::Device;
use rand::SeedableRng as _;
use wm_model::{
    sampler::{Given, Rollout},
    transition::{ActionAlignment, Parametrisation},
};

use super::{self_forcing::predict, *};
use crate::{
    arguments::tests::on_cpu,
    arguments::tests::run_in,
    optimiser::Variables,
    recipe::{Span, tests::bundled},
    run::tests::expect_same_bytes_after_pause,
    transition::{
        self, normals,
        tests::{flickering, moving, of_space},
    },
};

const STEPS: usize = 10;

/// File of a teacher trained on `train` for this many steps.
fn taught(
    dir: &Path,
    train: &Latents,
    (predicts, alignment): (Parametrisation, ActionAlignment),
    steps: u64,
) -> PathBuf {
    let mut recipe = transition::tests::small("paper", Some(1.0));
    recipe.length = Span::Steps(steps);
    recipe.batch = 8;
    recipe.model.frames = 6;
    recipe.model.frame_skip = 1;
    recipe.model.null_action = false;
    recipe.model.predicts = predicts;
    recipe.model.action_alignment = alignment;
    recipe.objective.forcing = transition::Forcing::Teacher;
    recipe.objective.action_dropout = 0.0;
    recipe.objective.history_noise = 0.05;
    recipe.optimisation.learning_rate = 4e-3;
    recipe.optimisation.warm_up = Span::Steps(10);
    recipe.optimisation.final_rate = 0.05;
    recipe.optimisation.ema_decay = 0.98;
    let out = dir.join(format!("teacher {predicts:?} {alignment:?} {steps}"));
    transition::tests::train_on(&run_in(&out), &recipe, None, train, None, &Stop::default())
        .unwrap();
    out.join(FILE)
}

fn tiny(settings: &[&str]) -> DistillRecipe {
    bundled("tiny", settings)
}

fn distil(
    out: &Path,
    recipe: &DistillRecipe,
    teacher: &Teacher,
    train: &Latents,
    held_out: Option<&Latents>,
    accept: bool,
) -> Result<RunEnd> {
    let gated = GateData {
        held_out,
        idm: None,
        accept,
    };
    train_on(
        &run_in(out),
        recipe,
        teacher,
        train,
        &gated,
        &Stop::default(),
    )
}

/// Figures of a model on windows, and the mean squared distance of its first predictions to the teacher's from the same
/// noise.
fn measured(model: &Transition, teacher: &Teacher, evaluation: &Windows) -> (Vec<f64>, f64, f64) {
    let measurement = Measurement {
        evaluation,
        encoding: &teacher.encoding,
        idm: None,
        plans: 0,
    };
    let model = model.pack().unwrap();
    let found = measurement.of(&model).unwrap();
    let taught = teacher.model.pack().unwrap();
    let mut distance = 0.0;
    for window in 0..evaluation.len() {
        let predicted = |model: &wm_model::transition::LoadedTransition| {
            let sampler = &model.config().sampler;
            let all = evaluation.predict(window, model, sampler, ActionChange::None);
            all.unwrap().remove(0)
        };
        let (a, b) = (predicted(&model), predicted(&taught));
        distance += wm_evaluation::squared(&a, &b).unwrap() / a.elem_count() as f64;
    }
    (
        found.ratios,
        found.motion,
        distance / evaluation.len() as f64,
    )
}

/// A recipe for toys: two stages in 500 steps.
fn short(steps: usize, settings: &[&str]) -> DistillRecipe {
    let own = [
        "length=500 steps",
        "self_forcing.after=300 steps",
        "self_forcing.frames=4",
    ];
    let mut recipe = tiny(&[&own, settings].concat());
    recipe.steps = steps;
    recipe
}

/// The second channel of these latents is unpredictable: the mean of possible futures has half the error of a sample, and no
/// motion. So errors alone are not enough; distance to the teacher and motion are measured too.
#[test]
fn student_matches_its_teacher_in_few_steps() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (flickering(dir.path(), 60, 1), flickering(dir.path(), 20, 2));
    let kind = (Parametrisation::Velocity, ActionAlignment::WithFrame);
    let file = taught(dir.path(), &train, kind, 800);
    let teacher = Teacher::open(&file, STEPS, &on_cpu()).unwrap();
    let evaluation = Windows::new(&held_out, &teacher.encoding, HORIZON, usize::MAX).unwrap();
    let measure = |name: &str, model: &Transition| {
        let (ratios, motion, distance) = measured(model, &teacher, &evaluation);
        let row = table_row(&ratios);
        println!("{name:<20} {row} motion {motion:.3} from the teacher {distance:.4}");
        (*ratios.last().unwrap(), motion, distance)
    };
    let (ratio, motion, _) = measure("teacher 10", &teacher.model);
    for steps in [1, 2] {
        let hurried = Teacher::open(&file, steps, &on_cpu()).unwrap().model;
        let hurried = measure(&format!("teacher {steps}"), &hurried);
        let student = |name: &str, settings: &[&str]| {
            let name = format!("{name} {steps}");
            let out = dir.path().join(&name);
            let recipe = short(steps, settings);
            distil(&out, &recipe, &teacher, &train, None, true).unwrap();
            let model = Transition::from_weights(Weights::open(out.join(FILE)).unwrap()).unwrap();
            assert_eq!(model.config().sampler.steps, steps);
            measure(&name, &model)
        };
        let first_stage = student("first stage", &["self_forcing.share=0"]);
        let both = student("student", &[]);
        // Over a rollout as good as its teacher, and not hurt by the second stage.
        assert!(both.0 < 1.1 * ratio, "{steps}: {both:?}");
        assert!(
            both.0 < 1.05 * first_stage.0,
            "{steps}: {both:?} {first_stage:?}"
        );
        // The teacher with as few steps is worse: it drifts with one, and blurs with two.
        assert!(
            steps > 1 || both.0 < 0.6 * hurried.0,
            "{both:?} {hurried:?}"
        );
        let most = [0.1, 0.4][steps - 1] * hurried.2;
        assert!(both.2 < most, "{steps}: {both:?} {hurried:?}");
        let away = |found: f64| (found - motion).abs();
        assert!(
            away(both.1) < 0.7 * away(hurried.1),
            "{steps}: {both:?} {hurried:?}"
        );
    }
}

/// Students that only approach the real frame have a lower error than their teacher, but do not move.
#[test]
fn gate_rejects_a_motionless_student() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (flickering(dir.path(), 60, 1), flickering(dir.path(), 20, 2));
    let kind = (Parametrisation::Residual, ActionAlignment::WithResult);
    let file = taught(dir.path(), &train, kind, 400);
    let teacher = Teacher::open(&file, STEPS, &on_cpu()).unwrap();
    let recipe = short(
        2,
        &[
            "self_forcing.real=1",
            "gate.plans=2",
            "gate.cem=10",
            "gate.idm=2",
        ],
    );
    let out = dir.path().join("student");
    let idm = crate::idm::tests::trained(&dir.path().join("idm"), &train);
    let distil = |accept| {
        let gated = GateData {
            held_out: Some(&held_out),
            idm: Some(&idm),
            accept,
        };
        let run = run_in(&out);
        train_on(&run, &recipe, &teacher, &train, &gated, &Stop::default())
    };
    let error = distil(false).unwrap_err().to_string();
    assert!(
        error.contains("motion is") && !error.contains("ratio"),
        "{error}"
    );
    assert!(out.join(REJECTED).is_file() && !out.join(FILE).exists());
    let told = std::fs::read_to_string(out.join("distill.gate.json")).unwrap();
    for figure in ["ratio_k1", "ratio_k8", "motion", "cem", "idm_r"] {
        assert!(told.contains(figure), "{told}");
    }
    // It is not trained again.
    let rejected = std::fs::read(out.join(REJECTED)).unwrap();
    distil(true).unwrap();
    assert!(rejected == std::fs::read(out.join(FILE)).unwrap());
}

#[test]
fn gate_rejects_a_broken_student_by_its_error() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (moving(dir.path(), 20, 1), moving(dir.path(), 4, 2));
    let kind = (Parametrisation::Residual, ActionAlignment::WithResult);
    let file = taught(dir.path(), &train, kind, 200);
    let teacher = Teacher::open(&file, STEPS, &on_cpu()).unwrap();
    let broken = [
        "length=5 steps",
        "optimisation.learning_rate=1",
        "gate.plans=0",
    ];
    let mut recipe = short(1, &broken);
    recipe.optimisation.ema_decay = 0.0;
    let out = dir.path().join("student");
    let error = distil(&out, &recipe, &teacher, &train, Some(&held_out), false);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("ratio_k8 is"), "{error}");
    assert!(out.join(REJECTED).is_file() && !out.join(FILE).exists());
}

#[test]
fn paused_training_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let latents = flickering(dir.path(), 2, 1);
    let kind = (Parametrisation::Velocity, ActionAlignment::WithFrame);
    let teacher = Teacher::open(&taught(dir.path(), &latents, kind, 3), STEPS, &on_cpu()).unwrap();
    // Pauses within either stage.
    for pause in [2, 4] {
        let train = |out: &Path, steps: u64| {
            let mut recipe = short(2, &["self_forcing.after=3 steps", "self_forcing.share=0.5"]);
            recipe.length = Span::Steps(steps);
            recipe.optimisation.final_rate = 1.0;
            distil(out, &recipe, &teacher, &latents, None, true).unwrap();
        };
        let files = [FILE, "distill.checkpoint.safetensors"];
        let out = dir.path().join(format!("pause at {pause}"));
        expect_same_bytes_after_pause(&out, &files, [pause, 6], train);
    }
}

#[test]
fn mismatch_with_the_teacher_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let kind = (Parametrisation::Velocity, ActionAlignment::WithFrame);
    let teacher = Teacher::open(&taught(dir.path(), &latents, kind, 1), STEPS, &on_cpu()).unwrap();
    teacher.require(&latents).unwrap();
    let other = of_space(dir.path(), 2, 3, "another");
    let error = format!("{:#}", teacher.require(&other).unwrap_err());
    assert!(
        error.contains("another") && error.contains("moving"),
        "{error}"
    );

    let out = dir.path().join("refused");
    let refused = |recipe: &DistillRecipe, accept| {
        let error = distil(&out, recipe, &teacher, &latents, None, accept);
        format!("{:#}", error.unwrap_err())
    };
    let error = refused(&short(10, &[]), true);
    assert!(error.contains("fewer than the teacher's 10"), "{error}");
    for (setting, name) in [
        ("self_forcing.frames=5", "self_forcing.frames is 5"),
        ("self_forcing.real=2", "self_forcing.real is 2"),
        ("huber=0", "huber is 0"),
        ("consistency.history=6", "consistency.history is 6"),
    ] {
        let error = refused(&short(2, &[setting]), true);
        assert!(error.contains(name), "{error}");
    }
    let error = refused(&short(2, &[]), false);
    assert!(error.contains("--accept"), "{error}");
}

#[test]
fn training_predicts_like_the_sampler() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    use {ActionAlignment::*, Parametrisation::*};
    for kind in [(Velocity, WithFrame), (Residual, WithResult)] {
        let file = taught(dir.path(), &latents, kind, 3);
        let teacher = Teacher::open(&file, 4, &on_cpu()).unwrap();
        let clips = ClipSource::new(&latents, &teacher.encoding, 5).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (frames, actions) = clips.batch(1, &mut rng).unwrap();
        let noise = normals(&[1, 1, 4, 4, 2], &Device::Cpu, &mut rng).unwrap();
        let history = frames.narrow(1, 0, 3).unwrap();
        let own = predict(
            &teacher.model,
            teacher.sampler(),
            &history,
            &actions,
            &noise,
        )
        .unwrap();

        let packed = teacher.model.pack().unwrap();
        let row = |i| actions.squeeze(0).unwrap().narrow(0, i, 1).unwrap();
        let past = actions.squeeze(0).unwrap().narrow(0, 0, 2).unwrap();
        let mut rollout =
            Rollout::new(&packed, teacher.sampler(), &history, Some(&past), 0).unwrap();
        let (noise, own_action) = (noise.squeeze(1).unwrap(), row(3));
        let given = Given {
            noise: Some(&noise),
            own_action: Some(&own_action),
        };
        let theirs = rollout.next_given(&row(2), given).unwrap();
        let distance = (own.squeeze(1).unwrap() - theirs).unwrap().abs().unwrap();
        let distance: f32 = distance.max_all().unwrap().to_scalar().unwrap();
        assert!(distance < 1e-4, "{kind:?}: {distance}");
    }
}

/// Slope of a loss along its gradient, by finite differences, and its expected value, the squared gradient.
fn differences(variables: &Variables, loss: &dyn Fn() -> Tensor) -> (f64, f64) {
    let value = || f64::from(loss().to_scalar::<f32>().unwrap());
    let gradient = variables
        .gradients(&loss().backward().unwrap(), &WeightGradients::default())
        .unwrap();
    let square: f64 = gradient
        .iter()
        .flatten()
        .map(|g| f64::from(*g).powi(2))
        .sum();
    let parameters = variables.parameters(|_| 0).unwrap();
    let at = |length: f64| {
        let moved = parameters
            .iter()
            .zip(&gradient)
            .map(|(parameter, gradient)| {
                let values = parameter.values.iter().zip(gradient);
                Parameter {
                    values: values
                        .map(|(w, g)| w + (length * f64::from(*g)) as f32)
                        .collect(),
                    ..parameter.clone()
                }
            });
        let moved: Vec<Parameter> = moved.collect();
        variables.assign(moved.iter().map(as_trained)).unwrap();
        value()
    };
    let length = 3e-3 / square.sqrt();
    let slope = (at(length) - at(-length)) / (2.0 * length);
    at(0.0);
    (slope, square)
}

#[test]
fn gradients_of_both_stages_match_finite_differences() {
    let dir = tempfile::tempdir().unwrap();
    let latents = flickering(dir.path(), 4, 1);
    use {ActionAlignment::*, Parametrisation::*};
    for kind in [(Velocity, WithFrame), (Residual, WithResult)] {
        let file = taught(dir.path(), &latents, kind, 30);
        let teacher = Teacher::open(&file, STEPS, &on_cpu()).unwrap();
        let recipe = short(2, &[]);
        let task =
            DistillTask::new(&recipe, &teacher, &latents, None, &run_in(dir.path())).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (networks, objective, clips) = (task.networks(), &task.objective, &task.clips);
        let batch = Batch::draw(objective, &task.student, clips, &mut rng).unwrap();
        let steps = Steps::draw(&networks, batch, 2, &task.levels, &mut rng).unwrap();
        let own = &recipe.self_forcing;
        let history = OwnHistory::draw(
            &networks,
            teacher.sampler(),
            objective,
            own,
            clips,
            &mut rng,
        );
        let history = history.unwrap();
        let consistency = || steps.loss(&task.student, 0.03).unwrap();
        let drift = || history.loss(&task.student, 0.5, 0.03).unwrap();
        let losses: [(&str, &dyn Fn() -> Tensor); 2] =
            [("consistency", &consistency), ("self-forcing", &drift)];
        for (name, loss) in losses {
            let (slope, square) = differences(&task.variables.tensors, loss);
            assert!(square > 1e-6, "{name}: {square}");
            let error = (slope / square - 1.0).abs();
            assert!(error < 0.03, "{kind:?} {name}: {slope} for {square}");
        }
    }
}
