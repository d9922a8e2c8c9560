use crate::judges::{Error, Result, endpoint::EndpointSettings, record::Tally};

/// Stops if the next answer may exceed the cost limit. It is assumed to need the largest input so far, and all allowed
/// output. The input of the first answer is unknown.
pub(super) fn check(settings: &EndpointSettings, tally: Tally) -> Result<()> {
    let Some(cap) = settings.max_cost else {
        return Ok(());
    };
    if tally.uncounted > 0 {
        return Err(Error::UsageMissing {
            judge: settings.name.clone(),
            answers: tally.uncounted,
        });
    }
    let mut next = tally.largest;
    if let Some(most) = settings.max_tokens {
        next.output_tokens = u64::from(most);
    }
    let spent = settings.price_per_million.of(tally.usage);
    let next = settings.price_per_million.of(next);
    if spent + next > cap {
        return Err(Error::CostCap {
            judge: settings.name.clone(),
            spent,
            next,
            cap,
        });
    }
    Ok(())
}
