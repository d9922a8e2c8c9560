//! Families of models.

use std::collections::BTreeMap;

use crate::findings::{FindingsError, Metric, ModelFindings, Section, comparison};

/// The mean of a family's models, unit by unit, for [`compare`](crate::findings::compare()) with another family: the paper's
/// "family-level rows", such as all semantic latent spaces against all others.
///
/// It has the figures that all members have. Figures that are not means over units are averaged over each draw of the
/// bootstrap, if all members have the same draws.
///
/// # Errors
/// [`FindingsError::EmptyFamily`] without members; [`FindingsError::NotComparable`] if data, seed or settings of the members
/// differ.
pub fn family(name: &str, members: &[&ModelFindings]) -> Result<ModelFindings, FindingsError> {
    let Some((first, others)) = members.split_first() else {
        return Err(FindingsError::EmptyFamily {
            family: name.to_owned(),
        });
    };
    for other in others {
        comparison::require_comparable(&first.header, &other.header)?;
    }
    let mut header = first.header.clone();
    header.model = name.to_owned();
    header.hash = joined(members, |member| &member.header.hash);
    header.space = joined(members, |member| &member.header.space);
    let all: Vec<BTreeMap<&str, &Metric>> = members.iter().map(|member| member.metrics()).collect();
    let sections = first.sections.iter().map(|section| {
        let mut mean = Section::new(section.suite);
        for name in section.metrics.keys() {
            let of_members: Option<Vec<&Metric>> = all
                .iter()
                .map(|own| own.get(name.as_str()).copied())
                .collect();
            if let Some(metric) = of_members.and_then(|metrics| mean_of(&metrics)) {
                mean.metrics.insert(name.clone(), metric);
            }
        }
        mean
    });
    Ok(ModelFindings {
        sections: sections.collect(),
        header,
    })
}

fn joined<'a>(members: &[&'a ModelFindings], of: impl Fn(&'a ModelFindings) -> &'a str) -> String {
    let parts: Vec<&str> = members.iter().map(|member| of(member)).collect();
    parts.join("+")
}

/// `None` if their units of measurement or better directions differ.
fn mean_of(metrics: &[&Metric]) -> Option<Metric> {
    let (first, others) = metrics.split_first()?;
    let alike = |other: &&&Metric| other.unit == first.unit && other.better == first.better;
    if !others.iter().all(|other| alike(&other)) {
        return None;
    }
    let count = metrics.len() as f64;
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count;
    let samples = first.samples.keys().filter_map(|unit| {
        let of_unit: Option<Vec<f64>> = metrics
            .iter()
            .map(|one| one.samples.get(unit).copied())
            .collect();
        Some((unit.clone(), mean(&mut of_unit?.into_iter())))
    });
    let draws = first.replicates.len();
    let same_draws =
        (others.iter()).all(|other| other.replicates.len() == draws && other.n == first.n);
    let replicates = (0..if same_draws { draws } else { 0 }).map(|draw| {
        let of_draw = metrics
            .iter()
            .filter_map(|one| one.replicates.get(draw).copied());
        mean(&mut of_draw.into_iter())
    });
    Some(Metric {
        value: mean(&mut metrics.iter().map(|one| one.value)),
        interval: None,
        samples: samples.collect(),
        replicates: replicates.collect(),
        ..(*first).clone()
    })
}
