use anyhow::Result;
use candle_core::{D, Device, Tensor};
use wm_zoo::{
    Dropout,
    success_probe::{GroundedProbe, ProbeNetwork, Reading, SuccessProbe},
};

use super::{
    episodes::{Question, Sample},
    things::{Target, Things},
};

/// The loss of what a probe is asked about one episode, whose instructions were read in the order of the questions (none is
/// for a probe that reads none): binary cross-entropy, and for a probe that looks for things, `pointing` times the cross-entropy of where it looks.
pub(super) fn loss(
    model: &ProbeNetwork,
    sample: &Sample,
    readings: &[Reading],
    pointing: Option<(&Things<'_>, f64)>,
    dropout: &mut Dropout<'_>,
) -> Result<Tensor> {
    match model {
        ProbeNetwork::Transformer(model) => of_transformer(model, sample, readings, dropout),
        ProbeNetwork::Grounded(model) => of_grounded(model, sample, readings, pointing, dropout),
        ProbeNetwork::Linear(_) | ProbeNetwork::Temporal(_) => {
            cross_entropy(&model.forward(&sample.latents, None)?, &sample.questions)
        }
    }
}

fn of_transformer(
    model: &SuccessProbe,
    sample: &Sample,
    readings: &[Reading],
    dropout: &mut Dropout<'_>,
) -> Result<Tensor> {
    let device = sample.latents.device();
    let mut logits = Vec::with_capacity(readings.len());
    for Reading { features, mask } in readings {
        let features = features.to_device(device)?;
        let mask = mask
            .as_ref()
            .map(|mask| mask.to_device(device))
            .transpose()?;
        let latents = &sample.latents;
        logits.push(model.forward_dropping(latents, &features, mask.as_ref(), dropout)?);
    }
    cross_entropy(&Tensor::cat(&logits, 0)?, &sample.questions)
}

fn of_grounded(
    model: &GroundedProbe,
    sample: &Sample,
    readings: &[Reading],
    pointing: Option<(&Things<'_>, f64)>,
    dropout: &mut Dropout<'_>,
) -> Result<Tensor> {
    let seen = model.look(&sample.latents)?;
    let asked = readings
        .iter()
        .map(|Reading { features, mask }| Ok(model.read(features, mask.as_ref())?));
    let asked = asked.collect::<Result<Vec<_>>>()?;
    let answers = model.answer(&seen, &asked, dropout)?;
    let loss = cross_entropy(&answers.logits, &sample.questions)?;
    let Some((things, share)) = pointing else {
        return Ok(loss);
    };
    let questions = sample.questions.iter().enumerate();
    let targets = questions.flat_map(|(number, question)| {
        let targets = things.targets(sample, &question.instruction, model.config());
        targets.into_iter().map(move |target| (number, target))
    });
    let targets: Vec<(usize, Target)> = targets.collect();
    match pointing_loss(&answers.attention, &targets)? {
        Some(pointing) => Ok((loss + (pointing * share)?)?),
        None => Ok(loss),
    }
}

/// The mean over all targets, by their shares, of -log of the part of the attention (frames, questions, queries, places)
/// that a query gives to its target; `None` where there are no targets.
pub(super) fn pointing_loss(
    attention: &Tensor,
    targets: &[(usize, Target)],
) -> Result<Option<Tensor>> {
    if targets.is_empty() {
        return Ok(None);
    }
    let (_, questions, queries, places) = attention.dims4()?;
    let row = |(question, target): &(usize, Target)| {
        ((target.frame * questions + question) * queries + target.query) as u32
    };
    let device = attention.device();
    let rows = Tensor::from_iter(targets.iter().map(row), device)?;
    let place = targets.iter().map(|(_, target)| target.place as u32);
    let place = Tensor::from_iter(place, device)?.unsqueeze(1)?;
    let rows = attention.reshape(((), places))?.index_select(&rows, 0)?;
    let right = rows.gather(&place, 1)?.squeeze(1)?;
    let sum: f64 = targets.iter().map(|(_, target)| target.share).sum();
    let shares = targets
        .iter()
        .map(|(_, target)| (target.share / sum) as f32);
    let shares = Tensor::from_iter(shares, device)?;
    let losses = (rows.log_sum_exp(D::Minus1)? - right)?;
    Ok(Some((losses * shares)?.sum_all()?))
}

/// The sum over questions of weight times max(x, 0) - x y + log(1 + exp(-|x|)): binary cross-entropy of logits, as
/// PyTorch's `BCEWithLogitsLoss`.
pub(super) fn cross_entropy(logits: &Tensor, questions: &[Question]) -> Result<Tensor> {
    let column = |value: &dyn Fn(&Question) -> f64| {
        let values = questions.iter().map(|question| value(question) as f32);
        Tensor::from_iter(values, &Device::Cpu)?.to_device(logits.device())
    };
    let truth = column(&|question| if question.answer { 1.0 } else { 0.0 })?;
    let weights = column(&|question| question.weight)?;
    let softened = (logits.abs()?.neg()?.exp()? + 1.0)?.log()?;
    let losses = ((logits.relu()? - (logits * truth)?)? + softened)?;
    Ok((losses * weights)?.sum_all()?)
}
