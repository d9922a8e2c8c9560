use std::sync::Arc;

use candle_core::Device;
use wm_planner::{Goals, SearchSpace, StepsToGoal, Term as _};

use super::{arguments::train_on, *};
use crate::{
    arguments::tests::run_in,
    recipe::{Span, tests::bundled},
    run::{Stop, tests::expect_same_bytes_after_pause},
    transition::tests::moving,
};

/// A small recipe for the episodes of [`moving`], with one camera frame per model step.
fn small(steps: u64) -> DistanceRecipe {
    let settings = [
        "batch=16",
        "micro_batch=8",
        "longest=10",
        "model.width=8",
        "model.hidden=16",
        "optimisation.ema_decay=0.9",
    ];
    let recipe: DistanceRecipe = bundled("tiny", &settings);
    DistanceRecipe {
        length: Span::Steps(steps),
        ..recipe
    }
}

fn train(out: &Path, recipe: &DistanceRecipe, latents: (&Latents, Option<&Latents>)) -> Result<()> {
    train_on(&run_in(out), recipe, 1, latents, &Stop::default()).map(drop)
}

/// A random walk tells little of the time that has passed: the quantiles must be as far apart as that.
#[test]
fn quantiles_hold_the_distances_that_they_claim() {
    let dir = tempfile::tempdir().unwrap();
    let (data, held_out) = (moving(dir.path(), 200, 1), moving(dir.path(), 30, 2));
    train(dir.path(), &small(400), (&data, Some(&held_out))).unwrap();
    let weights = Weights::open(dir.path().join(FILE)).unwrap();
    let model = TrainedDistance::from_weights(weights).unwrap();
    assert_eq!(model.space(), data.space());
    let ways = HindsightSource::new(&held_out, 1, 10).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut below, mut same, mut apart) = ([0, 0, 0], 0.0, 0.0);
    for _ in 0..400 {
        let way = ways.draw_near(&mut rng);
        let rows = [vec![way.present, way.goal], vec![way.present, way.present]];
        let found = model.steps(&ways.tensor(&rows).unwrap()).unwrap();
        for (below, steps) in below.iter_mut().zip(&found[0]) {
            *below += usize::from(ways.steps(way) <= *steps);
        }
        assert!(found[0].is_sorted(), "{found:?}");
        apart += found[0][1];
        same += found[1][1];
    }
    let [few, half, most] = below;
    assert!(
        few < 120 && (120..280).contains(&half) && most > 280,
        "{below:?}"
    );
    assert!(1.2 * same < apart, "{same} and {apart}");
}

#[test]
fn paused_training_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 4, 1);
    let train = |out: &Path, steps| {
        let mut recipe = small(steps);
        recipe.optimisation.final_rate = 1.0;
        train(out, &recipe, (&latents, None)).unwrap();
    };
    let files = [FILE, "distance.checkpoint.safetensors"];
    expect_same_bytes_after_pause(&dir.path().join("paused"), &files, [2, 4], train);
}

#[test]
fn unusable_shares_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let recipe = DistanceRecipe {
        others: 0.8,
        same: 0.3,
        ..small(1)
    };
    let error = train(dir.path(), &recipe, (&latents, None)).unwrap_err();
    assert!(error.to_string().contains("others is 0.8"), "{error}");
}

/// The planner's cost and `Plan.steps_to_goal`: of the last latent, not of the goal back to it.
#[test]
fn planners_count_the_steps_from_the_last_latent_to_the_goal() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    train(dir.path(), &small(100), (&latents, None)).unwrap();
    let weights = Weights::open(dir.path().join(FILE)).unwrap();
    let model = Arc::new(TrainedDistance::from_weights(weights).unwrap());
    let ways = HindsightSource::new(&latents, 1, 10).unwrap();
    // Two candidates of two steps, and the goal.
    let rows = [vec![0, 9], vec![9, 4], vec![7, 7]];
    let rows = ways.tensor(&rows).unwrap();
    let (candidates, goal) = (
        rows.narrow(0, 0, 2).unwrap(),
        rows.get(2).unwrap().get(0).unwrap(),
    );
    let last = |index| candidates.get(index).unwrap().get(1).unwrap();
    let median = |from: &Tensor, to: &Tensor| {
        let pair = Tensor::stack(&[from, to], 0).unwrap().unsqueeze(0).unwrap();
        model.steps(&pair).unwrap()[0][1] as f32
    };
    let space = SearchSpace::bounded(&[(-1.0, 1.0)], 1).unwrap();
    let term = StepsToGoal::new(Arc::clone(&model), goal.clone());
    let costs = term.costs(&space, &[], &candidates).unwrap();
    let expected = [0, 1].map(|index| median(&last(index), &goal));
    let back = [0, 1].map(|index| median(&goal, &last(index)));
    assert_eq!((term.name(), costs.as_slice()), ("steps", &expected[..]));
    assert_ne!(expected, back);
    let goals = Goals::from(vec![last(1), goal]);
    let observed = Goals::from(vec![last(0)]);
    assert_eq!(goals.steps_from(&observed, &model).unwrap(), expected[0]);
    assert!(
        Goals::default()
            .steps_from(&observed, &model)
            .unwrap()
            .is_nan()
    );
}

/// By hand: each error, weighted by the quantile above the truth and by its complement below.
#[test]
fn pinball_loss_weighs_both_sides() {
    let on = &Device::Cpu;
    let found = Tensor::new(&[[1.0_f32, 1.0], [4.0, 4.0]], on).unwrap();
    let truth = Tensor::new(&[[3.0_f32], [2.0]], on).unwrap();
    let loss = pinball(&found, &truth, &[0.1, 0.5]).unwrap();
    let expected = (0.1 * 2.0 + 0.5 * 2.0 + 0.9 * 2.0 + 0.5 * 2.0) / 4.0;
    assert!((loss.to_scalar::<f32>().unwrap() - expected).abs() < 1e-6);
}
