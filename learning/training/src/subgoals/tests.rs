use candle_core::DType;

use super::{arguments::train_on, *};
use crate::{
    arguments::tests::run_in,
    recipe::{Span, tests::bundled},
    run::{Stop, tests::expect_same_bytes_after_pause},
    transition::tests::{moving, of_space},
};

/// A small recipe for the episodes of [`moving`], with one camera frame per model step.
fn small(steps: u64) -> SubgoalRecipe {
    let settings = [
        "batch=8",
        "micro_batch=4",
        "distances=[1, 4]",
        "longest=8",
        "model.hidden=32",
        "model.depth=2",
        "model.heads=2",
        "optimisation.ema_decay=0.9",
    ];
    let recipe: SubgoalRecipe = bundled("tiny", &settings);
    SubgoalRecipe {
        length: Span::Steps(steps),
        ..recipe
    }
}

fn train(out: &Path, recipe: &SubgoalRecipe, latents: (&Latents, Option<&Latents>)) -> Result<()> {
    let start = (1, FreshWeights::new(recipe.seed));
    train_on(&run_in(out), recipe, start, latents, &Stop::default()).map(drop)
}

fn trained(out: &Path) -> TrainedSubgoals {
    TrainedSubgoals::from_weights(Weights::open(out.join(FILE)).unwrap()).unwrap()
}

/// The level of a latent of [`moving`], which is the same everywhere.
fn level(latent: &Tensor) -> f32 {
    let values = latent.narrow(2, 0, 1).unwrap().mean_all().unwrap();
    values.to_scalar().unwrap()
}

#[test]
fn subgoals_lie_between_the_present_and_the_goal() {
    let dir = tempfile::tempdir().unwrap();
    let (data, held_out) = (moving(dir.path(), 200, 1), moving(dir.path(), 30, 2));
    train(dir.path(), &small(600), (&data, Some(&held_out))).unwrap();
    let model = trained(dir.path());
    assert_eq!((model.distances(), model.frame_skip()), (&[1, 4][..], 1));
    let ways = HindsightSource::new(&held_out, 1, 8).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut own, mut persistence) = (0.0, 0.0);
    for _ in 0..60 {
        let way = ways.draw(&mut rng);
        let row = vec![way.goal, way.present, ways.on_the_way(way, 4)];
        let frames = ways.tensor(&[row]).unwrap().squeeze(0).unwrap();
        let [goal, present, truth] = [0, 1, 2].map(|index| frames.get(index).unwrap());
        let propose = |sampling| model.propose(&present, &goal, sampling).unwrap();
        let found = propose(SubgoalSampling::Expected);
        assert_eq!(found.len(), 2);
        own += (level(&found[1]) - level(&truth)).powi(2);
        persistence += (level(&present) - level(&truth)).powi(2);
        let sampled = |seed| level(&propose(SubgoalSampling::Sampled { seed, steps: 3 })[0]);
        assert_eq!(sampled(1), sampled(1));
        assert_ne!(sampled(1), sampled(2));
    }
    assert!(own < 0.4 * persistence, "{own} of {persistence}");
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
    let files = [FILE, "subgoals.checkpoint.safetensors"];
    expect_same_bytes_after_pause(&dir.path().join("paused"), &files, [2, 4], train);
}

#[test]
fn unusable_settings_and_latents_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let refused = |recipe: SubgoalRecipe| {
        let error = train(&dir.path().join("out"), &recipe, (&latents, None));
        format!("{:#}", error.unwrap_err())
    };
    for distances in [vec![], vec![2, 2], vec![0, 1]] {
        let error = refused(SubgoalRecipe {
            distances,
            ..small(1)
        });
        assert!(error.contains("distances"), "{error}");
    }
    let error = refused(SubgoalRecipe {
        longest: 3,
        ..small(1)
    });
    assert!(error.contains("longest is 3"), "{error}");
    train(dir.path(), &small(1), (&latents, None)).unwrap();
    let model = trained(dir.path());
    assert_eq!(model.space(), latents.space());
    assert_ne!(model.space(), of_space(dir.path(), 2, 3, "another").space());
    let latent = |side| Tensor::zeros((side, 4, 2), DType::F32, &Device::Cpu).unwrap();
    let error = model.propose(&latent(4), &latent(5), SubgoalSampling::Expected);
    let error = error.unwrap_err().to_string();
    assert!(
        error.contains("the goal") && error.contains("(4, 4, 2)"),
        "{error}"
    );
}
