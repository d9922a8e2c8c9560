//! Sources whose offers come late repeatedly: the arm must not start and stop with each offer.

use std::time::Duration;

use super::{Offer, Refusal, Source};

/// A source whose lateness brought the arm to rest has to be in time for this long before the arm moves again \[ns\].
const FIRST_PROBATION_NS: i64 = 2_000_000_000;
/// The same after several relapses \[ns\].
const LONGEST_PROBATION_NS: i64 = 16_000_000_000;
/// A source is reported after this many offers in a row whose first half was over.
const REPORTED: u32 = 3;
/// After this long without a late offer, the next one is reported again \[ns\].
const QUIET_NS: i64 = 30_000_000_000;
/// After this long without an offer, the source begins anew \[ns\].
const FORGOTTEN_NS: i64 = 10_000_000_000;

/// A report of a late source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LateNotice {
    /// The source.
    pub source: Source,
    /// From the beginning of the last offer to its reception \[s\].
    pub late_s: f64,
    /// Duration of the last offer \[s\].
    pub span_s: f64,
    /// Whether the arm stands still until the source is in time.
    pub is_refused: bool,
}

impl std::fmt::Display for LateNotice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { late_s, span_s, .. } = self;
        let name = self.source.name();
        write!(f, "{name}s come {late_s:.2} s late, of {span_s:.2} s; ")?;
        f.write_str(match self.is_refused {
            true => "they are refused until they come in time",
            false => "they are executed from the present on, without their beginnings",
        })?;
        f.write_str(": send them earlier, send longer ones, or set begin to reception")
    }
}

/// State of the arm when an offer comes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Course {
    /// By the node's clock \[ns\].
    pub now_ns: i64,
    /// Whether it stands still with nothing to execute.
    pub is_at_rest: bool,
    /// When the last offer was over, if nothing came between \[ns\].
    pub over_ns: Option<i64>,
}

/// A rest between two offers, by the node's clock \[ns\].
#[derive(Clone, Copy, Debug)]
struct Gap {
    from_ns: i64,
    /// None while it lasts.
    to_ns: Option<i64>,
    /// The part of it that late offers would have filled, and the time up to which that is counted.
    filled_ns: i64,
    counted_ns: i64,
}

impl Gap {
    fn new(from_ns: i64) -> Self {
        Self {
            from_ns,
            to_ns: None,
            filled_ns: 0,
            counted_ns: from_ns,
        }
    }

    /// Counts a late offer; whether late offers have caused most of the rest by now, and more than `grace_ns`.
    fn fill(&mut self, offer: &Offer, now_ns: i64, grace_ns: i64) -> bool {
        let to_ns = self.to_ns.unwrap_or(now_ns);
        let until_ns = offer.end_ns().min(to_ns);
        let since_ns = offer.begin_ns.max(self.counted_ns);
        self.filled_ns += until_ns.saturating_sub(since_ns).max(0);
        self.counted_ns = self.counted_ns.max(until_ns);
        self.filled_ns > grace_ns && self.filled_ns > to_ns.saturating_sub(self.from_ns) / 2
    }
}

/// Lateness of a source, and its consequence.
#[derive(Clone, Debug)]
pub(super) struct Lateness {
    /// Gaps that are shorter do not bring the arm to rest \[ns\].
    grace_ns: i64,
    /// An offer with less left would start the arm only to stop it \[ns\].
    least_ns: i64,
    is_refusing: bool,
    probation_ns: i64,
    /// Since when and until when the offers that came would have kept the arm moving \[ns\].
    covered: Option<(i64, i64)>,
    /// The last rest between two offers.
    gap: Option<Gap>,
    in_a_row: u32,
    last_ns: Option<i64>,
    /// The last offer that came after its beginning \[ns\].
    last_late_ns: Option<i64>,
    last_reported_ns: Option<i64>,
    recovered_ns: Option<i64>,
    notice: Option<LateNotice>,
}

impl Lateness {
    /// For an arm that does not stop in a gap of `grace` between two offers, and takes `least` to start and stop.
    pub fn new(grace: Duration, least: Duration) -> Self {
        // 64 bits of nanoseconds hold 292 years.
        let nanos = |duration: Duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX);
        Self {
            grace_ns: nanos(grace),
            least_ns: nanos(least),
            is_refusing: false,
            probation_ns: FIRST_PROBATION_NS,
            covered: None,
            gap: None,
            in_a_row: 0,
            last_ns: None,
            last_late_ns: None,
            last_reported_ns: None,
            recovered_ns: None,
            notice: None,
        }
    }

    /// The source begins anew.
    pub fn reset(&mut self) {
        let (grace_ns, least_ns) = (self.grace_ns, self.least_ns);
        *self = Self {
            grace_ns,
            least_ns,
            // One log line is enough, however often the node is armed.
            last_reported_ns: self.last_reported_ns,
            notice: self.notice.take(),
            ..Self::new(Duration::ZERO, Duration::ZERO)
        };
    }

    /// Whether an offer was late in the last seconds.
    pub fn is_late_at_times(&self, now_ns: i64) -> bool {
        self.last_late_ns
            .is_some_and(|last_ns| now_ns.saturating_sub(last_ns) <= FORGOTTEN_NS)
    }

    /// The report since the last call, if there is one.
    pub fn take_notice(&mut self) -> Option<LateNotice> {
        self.notice.take()
    }

    /// Takes an offer that passed every other check of its time.
    ///
    /// # Errors
    /// [`Refusal::Late`] or [`Refusal::Behind`]: it is not executed.
    pub fn judge(&mut self, offer: &Offer, course: Course) -> Result<(), Refusal> {
        let now_ns = course.now_ns;
        let is_forgotten = |last_ns: i64| now_ns.saturating_sub(last_ns) > FORGOTTEN_NS;
        if self.last_ns.replace(now_ns).is_some_and(is_forgotten) {
            self.reset();
            self.last_ns = Some(now_ns);
        }
        let late_ns = now_ns.saturating_sub(offer.begin_ns);
        let left_ns = offer.end_ns().saturating_sub(now_ns);
        let span_ns = offer.end_ns().saturating_sub(offer.begin_ns);
        if late_ns > 0 {
            self.last_late_ns = Some(now_ns);
        }
        self.cover(now_ns, now_ns.saturating_add(left_ns.max(0)));
        let judged = self.expect_motion(offer, course, late_ns, left_ns);
        let is_half_over = late_ns > span_ns / 2;
        self.in_a_row = if is_half_over { self.in_a_row + 1 } else { 0 };
        if judged.is_err() || self.in_a_row >= REPORTED {
            let is_new = self
                .last_reported_ns
                .is_none_or(|last_ns| now_ns.saturating_sub(last_ns) > QUIET_NS);
            self.last_reported_ns = Some(now_ns);
            if is_new {
                self.notice = Some(LateNotice {
                    source: offer.source,
                    late_s: late_ns as f64 / 1e9,
                    span_s: span_ns as f64 / 1e9,
                    is_refused: judged.is_err(),
                });
            }
        }
        judged
    }

    /// Records an offer that lasts until `until_ns`.
    fn cover(&mut self, now_ns: i64, until_ns: i64) {
        self.covered = match self.covered {
            Some((since_ns, before_ns)) if before_ns.saturating_add(self.grace_ns) >= now_ns => {
                Some((since_ns, before_ns.max(until_ns)))
            }
            _ => Some((now_ns, until_ns)),
        };
    }

    fn expect_motion(
        &mut self,
        offer: &Offer,
        course: Course,
        late_ns: i64,
        left_ns: i64,
    ) -> Result<(), Refusal> {
        let now_ns = course.now_ns;
        let behind = || match left_ns > 0 {
            true => Err(Refusal::Behind {
                late_s: late_ns as f64 / 1e9,
                left_s: left_ns as f64 / 1e9,
            }),
            false => Err(Refusal::Late {
                ago_s: left_ns.saturating_neg() as f64 / 1e9,
            }),
        };
        if self.is_refusing {
            let since_ns = self.covered.map_or(now_ns, |(since_ns, _)| since_ns);
            if left_ns <= 0 || now_ns.saturating_sub(since_ns) < self.probation_ns {
                return behind();
            }
            self.is_refusing = false;
            self.recovered_ns = Some(now_ns);
            return Ok(());
        }
        // Had late offers come in time, the arm would have rested for a shorter time, or not at all.
        let rest = course.over_ns.filter(|_| course.is_at_rest);
        if let Some(over_ns) = rest
            && self.gap.is_none_or(|gap| gap.from_ns != over_ns)
        {
            self.gap = Some(Gap::new(over_ns));
        }
        let grace_ns = self.grace_ns;
        let is_to_blame = |gap: &mut Gap| late_ns > 0 && gap.fill(offer, now_ns, grace_ns);
        if self.gap.as_mut().is_some_and(is_to_blame) {
            self.refuse(now_ns);
            return behind();
        }
        let is_too_short = course.is_at_rest && left_ns < self.least_ns.min(late_ns);
        if left_ns <= 0 || is_too_short {
            return behind();
        }
        if let Some(gap) = self.gap.as_mut().filter(|_| rest.is_some()) {
            gap.to_ns = Some(now_ns.max(offer.begin_ns));
        }
        Ok(())
    }

    /// The arm is at rest because offers were late: it stays there until they are in time for a while.
    fn refuse(&mut self, now_ns: i64) {
        let is_relapse = self.recovered_ns.is_some_and(|recovered_ns| {
            now_ns.saturating_sub(recovered_ns) < self.probation_ns.saturating_mul(4)
        });
        self.probation_ns = match is_relapse {
            true => (self.probation_ns * 2).min(LONGEST_PROBATION_NS),
            false => FIRST_PROBATION_NS,
        };
        (self.is_refusing, self.gap) = (true, None);
        let until_ns = self.covered.map_or(now_ns, |(_, until_ns)| until_ns);
        self.covered = Some((now_ns, until_ns));
    }
}
