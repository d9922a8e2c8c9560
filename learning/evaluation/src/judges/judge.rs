//! A judge of rollouts.

mod cost;
mod form;

use std::sync::Arc;

use serde_json::{Value, json};
use tracing::warn;

use crate::judges::{
    Error, Result,
    endpoint::{Client, Clock, EndpointSettings, Picture, Sampling, SystemClock, request},
    frames::FrameChoice,
    prompts::Prompts,
    record::{Answer, Entry, Outcome, Record, Tally, question_key},
    rollout::Rollout,
    verdict::{RubricScores, SuccessScore, VerdictError},
};
use form::Form;

/// Result of a judge.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Judgement<T> {
    /// `None` without a usable answer, which the record has and counts.
    pub verdict: Option<T>,
    /// Whether it was in the record already.
    pub from_record: bool,
    /// Key of the entry in the record.
    pub key: String,
}

/// A model that judges rollouts with one question each. Every answer goes to a [`Record`] before it is returned.
#[derive(Debug)]
pub struct Judge {
    client: Client,
    prompts: Arc<Prompts>,
    frames: FrameChoice,
}

impl Judge {
    /// A judge that sees `frames` of each video. Sends nothing yet.
    ///
    /// # Errors
    /// If a setting is invalid, or the environment lacks the API key.
    pub fn new(
        settings: EndpointSettings,
        prompts: Arc<Prompts>,
        frames: FrameChoice,
    ) -> Result<Self> {
        Self::with_clock(settings, prompts, frames, Arc::new(SystemClock::default()))
    }

    /// [`Self::new`] with another clock.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn with_clock(
        settings: EndpointSettings,
        prompts: Arc<Prompts>,
        frames: FrameChoice,
        clock: Arc<dyn Clock>,
    ) -> Result<Self> {
        frames.check()?;
        Ok(Self {
            client: Client::with_clock(settings, clock)?,
            prompts,
            frames,
        })
    }

    /// Settings of its endpoint.
    #[must_use]
    pub fn settings(&self) -> &EndpointSettings {
        self.client.settings()
    }

    /// Name of the judge.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.settings().name
    }

    /// Judges whether the robot followed the instruction: 0 or 1, or 0.5 if the rollout has partial criteria.
    ///
    /// # Errors
    /// If the server does not answer, the next answer may exceed the cost limit, or the record cannot be written. An
    /// unusable answer is not an error.
    pub fn success(
        &mut self,
        rollout: &Rollout,
        record: &mut Record,
    ) -> Result<Judgement<SuccessScore>> {
        let criteria = rollout.partial_criteria.as_deref();
        let prompt = self.prompts.success(&rollout.instruction, criteria);
        let form = Form::Success {
            partial: criteria.is_some(),
        };
        self.ask(form, &prompt, rollout, record, |outcome| match outcome {
            Outcome::Success(score) => Some(score),
            _ => None,
        })
    }

    /// Judges interaction quality, perspectivity and instruction following, 1 to 5 each.
    ///
    /// # Errors
    /// Those of [`Self::success`].
    pub fn rubric(
        &mut self,
        rollout: &Rollout,
        record: &mut Record,
    ) -> Result<Judgement<RubricScores>> {
        let prompt = self.prompts.rubric(&rollout.instruction);
        self.ask(
            Form::Rubric,
            &prompt,
            rollout,
            record,
            |outcome| match outcome {
                Outcome::Rubric(scores) => Some(scores),
                _ => None,
            },
        )
    }

    fn ask<T>(
        &mut self,
        form: Form,
        prompt: &str,
        rollout: &Rollout,
        record: &mut Record,
        verdict: impl FnOnce(Outcome) -> Option<T>,
    ) -> Result<Judgement<T>> {
        let settings = self.client.settings();
        let frames = self.frames.indices(rollout.frames.len());
        let pictures = frames
            .iter()
            .filter_map(|i| Some((*i, rollout.frames.get(*i)?)));
        let pictures = pictures.map(|(i, frame)| Picture::encode(frame, i, &settings.picture));
        let pictures: Vec<Picture> = pictures.collect::<Result<_>>()?;
        if pictures.is_empty() {
            return Err(Error::NoFrames {
                instruction: rollout.instruction.clone(),
            });
        }
        let hashes = pictures.iter().map(|picture| picture.pixel_hash.as_str());
        let request = request(settings, self.sampling(0), prompt, hashes);
        // Includes the name: private servers often use one model name.
        let how = json!([
            self.name(),
            form.name(),
            rollout.trial,
            settings.picture,
            settings.reask_temperature,
        ]);
        let key = question_key(&[&request, &how]);
        if let Some(outcome) = record.outcome(&key) {
            return Ok(Judgement {
                verdict: verdict(outcome.clone()),
                from_record: true,
                key,
            });
        }

        let mut answers = Vec::new();
        let tally = record.tally(self.name());
        let result = self.ask_until_usable(form, prompt, &pictures, &key, tally, &mut answers);
        // Paid answers must not be lost, even if unusable.
        let (outcome, error) = match result {
            Ok(outcome) => (outcome, None),
            Err(error) if answers.is_empty() => return Err(error),
            Err(error) => (Outcome::Interrupted(error.to_string()), Some(error)),
        };
        record.append(Entry {
            key: key.clone(),
            stamp_ns: rollout.stamp_ns,
            judge: self.name().to_owned(),
            instruction: rollout.instruction.clone(),
            trial: rollout.trial,
            frames,
            request,
            answers,
            outcome: outcome.clone(),
        })?;
        match error {
            Some(error) => Err(error),
            None => Ok(Judgement {
                verdict: verdict(outcome),
                from_record: false,
                key,
            }),
        }
    }

    fn ask_until_usable(
        &mut self,
        form: Form,
        prompt: &str,
        pictures: &[Picture],
        key: &str,
        mut tally: Tally,
        answers: &mut Vec<Answer>,
    ) -> Result<Outcome> {
        // The first 16 digits of a hash.
        let jitter_seed = key
            .get(..16)
            .and_then(|digits| u64::from_str_radix(digits, 16).ok());
        let mut last_problem = String::new();
        for reask in 0..=self.settings().reasks {
            cost::check(self.settings(), tally)?;
            let sampling = self.sampling(reask);
            let urls = pictures.iter().map(|picture| picture.data_url.as_str());
            let body: Value = request(self.settings(), sampling, prompt, urls);
            let reply = self.client.ask(&body, jitter_seed.unwrap_or_default())?;
            let found = if reply.finish_reason.as_deref() == Some("length") {
                Err(VerdictError::CutOff {
                    excerpt: crate::judges::excerpt::excerpt_of_end(&reply.text),
                })
            } else {
                form.parse(&reply.text)
            };
            let answer = Answer {
                seed: sampling.seed,
                temperature: sampling.temperature,
                text: reply.text,
                finish_reason: reply.finish_reason,
                model: reply.model,
                usage: reply.usage,
                attempts: reply.attempts,
                problem: found.as_ref().err().map(ToString::to_string),
            };
            tally.add(&answer);
            answers.push(answer);
            match found {
                Ok(outcome) => return Ok(outcome),
                Err(error) => {
                    last_problem = error.to_string();
                    warn!(
                        judge = self.name(),
                        reask,
                        problem = last_problem,
                        "no verdict"
                    );
                }
            }
        }
        Ok(Outcome::Unusable(last_problem))
    }

    fn sampling(&self, reask: u32) -> Sampling {
        let settings = self.settings();
        let again = settings.reask_temperature.filter(|_| reask > 0);
        Sampling {
            temperature: again.or(settings.temperature),
            seed: settings
                .seed
                .map(|seed| seed.wrapping_add(u64::from(reask))),
        }
    }
}
