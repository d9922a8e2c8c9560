//! The checks of offers, and the inputs of the veto.

use std::time::Duration;

use wm_msgs::wm_msgs::{ActionCandidates, ActionChunk, Assessment, Plan, PredictionError};

use super::{Cause, ExecutorStep, Moment, Offer, Phase, Refusal, Taken, Waiting};
use crate::executor::{Begin, Hold, lateness::Course, refusal::stamp_of, veto::Verdict};

/// Chunks that may wait for their assessments.
const MOST_WAITING: usize = 8;

impl ExecutorStep {
    /// Takes a policy's chunk.
    ///
    /// # Errors
    /// [`Refusal`]: it is not executed.
    pub fn chunk(
        &mut self,
        chunk: &ActionChunk,
        received: Moment,
        now: Moment,
    ) -> Result<Taken, Refusal> {
        self.offer(Offer::of_chunk(chunk), received, now)
    }

    /// Takes a planner's plan.
    ///
    /// # Errors
    /// [`Refusal`]: it is not executed.
    pub fn plan(&mut self, plan: &Plan, received: Moment, now: Moment) -> Result<Taken, Refusal> {
        self.offer(Offer::of_plan(plan), received, now)
    }

    fn offer(
        &mut self,
        offer: Result<Offer, Refusal>,
        received: Moment,
        now: Moment,
    ) -> Result<Taken, Refusal> {
        self.settings.clock.see(now);
        let taken = offer.and_then(|offer| self.consider(offer, received, now));
        if let Err(refusal) = &taken {
            self.note(refusal);
        }
        taken
    }

    pub(super) fn consider(
        &mut self,
        mut offer: Offer,
        received: Moment,
        now: Moment,
    ) -> Result<Taken, Refusal> {
        match &self.phase {
            Phase::Armed => {}
            Phase::DryRun if self.settings.dry_run => {}
            Phase::DryRun | Phase::Disarming(_) => return Err(Refusal::NotArmed),
            Phase::Stopped(_) => return Err(Refusal::Stopped),
        }
        let settings = &self.settings;
        // An offer that begins at zero would be over with the first message on /clock.
        if now.stamp_ns == 0 {
            return Err(Refusal::NoClock);
        }
        offer.expect_captured(now)?;
        // Without measured joints no motion is allowed, and its beginning is not known.
        if let Some(joints) = &settings.joints {
            joints.check(now.at)?;
        }
        let joints = settings.joints.as_ref();
        settings.bounds.check(&offer, &settings.layout, joints)?;
        if !settings.base_frame.is_empty() && settings.base_frame != offer.frame_id {
            return Err(Refusal::Frame {
                expected: settings.base_frame.clone(),
                actual: offer.frame_id,
            });
        }
        if let Some(actual) = offer.epoch {
            let newest = self.epoch.map_or(actual, |newest| newest.max(actual));
            if actual < newest {
                return Err(Refusal::Epoch { newest, actual });
            }
            if self.epoch.replace(newest) != Some(newest) {
                let (was_begun, dropped) = self.schedule.drop_older(newest);
                if was_begun {
                    self.counts.interrupted += 1;
                    self.cause = Some(Cause::OldEpoch);
                }
                // A length fits.
                self.counts.refused += dropped as u64;
            }
        }
        if self.settings.begin == Begin::Reception {
            offer.begin_ns = now.stamp_ns;
        }
        self.expect_timely(&offer, received, now)?;
        self.expect_free(now)?;
        self.settings.camera.expect_seen(&offer)?;
        let course = Course {
            now_ns: now.stamp_ns,
            is_at_rest: self.velocity.is_zero() && self.schedule.is_empty(),
            over_ns: self.over_ns,
        };
        self.lateness.judge(&offer, course)?;
        self.expect_newest(&offer)?;
        match self.vetoes.judge(&offer) {
            Verdict::Veto(veto) => Err(veto.into()),
            Verdict::Pass => {
                self.schedule.push(offer, received)?;
                Ok(Taken::Accepted)
            }
            Verdict::Unassessed => {
                let since = now.at;
                self.waiting.push_back(Waiting {
                    offer,
                    received,
                    since,
                });
                if self.waiting.len() > MOST_WAITING {
                    self.waiting.pop_front();
                    self.note(&Refusal::Crowded {
                        waiting: MOST_WAITING,
                    });
                }
                Ok(Taken::Waiting)
            }
        }
    }

    fn expect_timely(&self, offer: &Offer, received: Moment, now: Moment) -> Result<(), Refusal> {
        let seconds = |ns: i64| ns as f64 / 1e9;
        let mut age = received.age(now);
        if self.settings.begin == Begin::Reception {
            // It is never late: only its stamp shows that it waited elsewhere.
            let since_ns = now.stamp_ns.saturating_sub(offer.stamp_ns);
            // A stamp in the future adds no age.
            age = age.max(Duration::from_nanos(u64::try_from(since_ns).unwrap_or(0)));
        }
        if age > self.settings.max_age {
            return Err(Refusal::Stale {
                age_s: age.as_secs_f64(),
                most_s: self.settings.max_age.as_secs_f64(),
            });
        }
        let ahead_s = seconds(offer.stamp_ns.saturating_sub(now.stamp_ns));
        let most_s = self.settings.max_lead.as_secs_f64();
        if ahead_s > most_s {
            return Err(Refusal::Early { ahead_s, most_s });
        }
        Ok(())
    }

    fn expect_newest(&self, offer: &Offer) -> Result<(), Refusal> {
        match self.schedule.newest_ns() {
            Some(newest_ns) if offer.made_ns < newest_ns => Err(Refusal::Older {
                before_s: newest_ns.saturating_sub(offer.made_ns) as f64 / 1e9,
            }),
            _ => Ok(()),
        }
    }

    /// Checks that no condition of motion is missing.
    pub(super) fn expect_free(&self, now: Moment) -> Result<(), Hold> {
        self.settings.clock.check(now)?;
        self.settings.camera.check(now)?;
        let now = now.at;
        if let Some(deadman) = &self.settings.deadman {
            deadman.check(now)?;
        }
        if let Some(workspace) = &self.settings.workspace {
            workspace.check(now)?;
        }
        if let Some(joints) = &self.settings.joints {
            joints.check(now)?;
            // A dry run moves nothing.
            if self.phase != Phase::DryRun {
                joints.check_following()?;
            }
        }
        Ok(())
    }

    /// Takes a policy's candidates, to which an assessment refers.
    ///
    /// # Errors
    /// [`Refusal::Stamp`]: they are dropped.
    pub fn candidates(&mut self, candidates: &ActionCandidates) -> Result<(), Refusal> {
        let stamp_ns = stamp_of("action_candidates", candidates.header.stamp)?;
        self.vetoes.candidates(stamp_ns, candidates);
        Ok(())
    }

    /// Takes an assessment of a policy's candidates: chunks that waited for it are checked again, and the current one
    /// may be vetoed. Returns the refusals.
    pub fn assessment(&mut self, assessment: &Assessment, now: Moment) -> Vec<Refusal> {
        let stamp_ns = match stamp_of("assessment", assessment.candidates_stamp) {
            Ok(stamp_ns) => stamp_ns,
            Err(malformed) => return vec![malformed],
        };
        self.vetoes.assessment(stamp_ns, assessment);
        let mut refused = Vec::new();
        let waiting = std::mem::take(&mut self.waiting);
        for waiting in waiting {
            if waiting.offer.stamp_ns != stamp_ns {
                self.waiting.push_back(waiting);
            } else if let Err(refusal) = self.consider(waiting.offer, waiting.received, now) {
                self.note(&refusal);
                refused.push(refusal);
            }
        }
        let vetoes = &self.vetoes;
        let (of_current, of_next) = self.schedule.veto(|offer| match vetoes.judge(offer) {
            Verdict::Veto(veto) if offer.stamp_ns == stamp_ns => Some(veto),
            _ => None,
        });
        if of_current.is_some() {
            self.counts.interrupted += 1;
            self.cause = Some(Cause::Vetoed);
        }
        // A length fits.
        self.counts.refused += of_next.len() as u64;
        for veto in of_current.into_iter().chain(of_next) {
            self.counts.vetoed += 1;
            let refusal = Refusal::Vetoed(veto);
            self.refusal = Some(refusal.to_string());
            refused.push(refusal);
        }
        refused
    }

    /// Takes the error of a prediction.
    pub fn prediction_error(&mut self, error: &PredictionError) {
        self.vetoes.prediction_error(error);
    }
}
