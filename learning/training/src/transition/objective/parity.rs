//! Training steps of the transition model against PyTorch.

use super::*;
use crate::{
    fixture::{Fixture, fill, tensor},
    optimiser::{AdamW, ParameterValues},
    transition::tests::fresh,
    workers::BatchLoss,
};
use wm_model::transition::WeightGradients;

/// Seed of weights that are replaced at once.
const ANY: u64 = 1;

fn draws(objective: &Objective, config: &TransitionConfig) -> Draws {
    let (b, n, past) = (
        objective.micro_batch,
        config.max_frames,
        objective.recipe.history,
    );
    let clean = match objective.recipe.forcing {
        Forcing::Teacher => n - 1,
        Forcing::Diffusion => past,
    };
    let frames = |count| {
        [
            b,
            count,
            config.latent_height,
            config.latent_width,
            config.channels,
        ]
    };
    Draws {
        history_levels: tensor("history levels", &[b, clean], 0.5),
        history_noise: tensor("history noise", &frames(clean), 1.5),
        noise: tensor("noise", &frames(n - past), 1.5),
        tau: (tensor("tau", &[b, n - past], 0.5) + 0.5).unwrap(),
    }
}

/// Loss and gradients of one step, by training, candle and its operations; and the step itself, if in the fixture.
#[test]
fn step_matches_pytorch() {
    for name in [
        "transition--diffusion",
        "transition--diffusion-wide",
        "transition--teacher",
        "transition--teacher-residual",
        "transition--teacher-own",
    ] {
        let fixture = Fixture::open(name);
        let config: TransitionConfig = fixture.of("config");
        let objective = Objective {
            clips: 2,
            micro_batch: 2,
            shift: 1.0,
            seed: ANY,
            recipe: fixture.of("objective"),
        };
        objective.validate(&config).unwrap();
        let (h, w, c) = (config.latent_height, config.latent_width, config.channels);
        let latents = tensor("latents", &[2, config.max_frames, h, w, c], 1.5);
        let actions = tensor("actions", &[2, config.max_frames, config.action_dim], 1.5);
        let (clips, draws) = ((&latents, &actions), draws(&objective, &config));
        let (alignment, past) = (config.action_alignment, objective.recipe.history);
        let own = objective.recipe.own_history == 1.0;
        let gradients = WeightGradients::default();
        let ways: [&dyn Fn(Transition) -> Transition; 3] = [
            &|model| model.collecting(&gradients),
            &|model| model,
            &Transition::plain,
        ];
        for way in ways {
            let (variables, model) = fresh(&config, ANY);
            fill(&variables);
            let model = way(model);
            let loss = match objective.recipe.forcing {
                Forcing::Diffusion => noised_at_once::loss(&model, clips, &draws, past),
                Forcing::Teacher => Batch::new(alignment, clips, &draws, past)
                    .and_then(|batch| batch.loss_after(&model, own, past)),
            };
            let loss = BatchLoss {
                gradients: gradients.clone(),
                ..BatchLoss::from(loss.unwrap())
            };
            let gradients = fixture.check(loss, &variables);
            if fixture.names("norm").is_empty() {
                continue;
            }
            let parameters = variables.parameters(|_| 0).unwrap();
            let mut optimiser = AdamW::new(parameters, fixture.of("optimiser"));
            let norm = optimiser.step(&gradients, fixture.of("learning_rate"));
            fixture.check_one("norm", &[norm.unwrap() as f32]);
            check_after(&fixture, "after", optimiser.weights());
            check_after(&fixture, "averaged", optimiser.averaged());
        }
    }
}

fn check_after<'a>(
    fixture: &Fixture,
    what: &str,
    found: impl Iterator<Item = ParameterValues<'a>>,
) {
    let expected = fixture.names(&format!("{what}/"));
    let found: Vec<_> = found
        .filter(|w| expected.iter().any(|e| e == w.name))
        .collect();
    assert!(!expected.is_empty() && found.len() == expected.len());
    let errors = found.iter().map(|weight| {
        let name = format!("{what}/{}", weight.name);
        fixture.check_one(&name, weight.values)
    });
    let worst = errors.fold(0.0, f64::max);
    println!("{what} the step: {worst:.1e}");
}
