use wm_metrics::findings::{Better, Metric, Section};
use wm_metrics::{
    MetricError, Table,
    distributions::{
        Estimator, Moments, PolynomialKernel, frechet_distance, jepa_similarity,
        maximum_mean_discrepancy,
    },
};

use super::super::{BySource, FeatureSpace, Vectors};

/// Vectors per block: 16 MB with 2048 features.
const BLOCK: usize = 1024;

/// A figure of all vectors together.
struct Distance {
    name: &'static str,
    about: &'static str,
    better: Better,
    predicted: f64,
    ceiling: f64,
}

/// Adds the distances of predictions and of reconstructions to the true frames.
pub(super) fn add(section: &mut Section, space: FeatureSpace, features: &[&BySource<Vectors>]) {
    let distances = match space {
        FeatureSpace::Fid => {
            let about = "Fréchet distance of the features of frames";
            frechet(features, "fid", about).map(|distance| vec![distance])
        }
        FeatureSpace::Fvd => {
            let about = "Fréchet distance of the features of clips";
            frechet(features, "fvd", about).map(|distance| vec![distance])
        }
        FeatureSpace::Jepa => jepa(features),
    };
    let distances = match distances {
        Ok(distances) => distances,
        Err(error) => {
            for name in space.metrics() {
                section.absent(name, error.to_string());
            }
            return;
        }
    };
    for Distance {
        name,
        about,
        better,
        predicted,
        ceiling,
    } in distances
    {
        let (gap, difference) = match better {
            Better::Higher => (ceiling - predicted, "ceiling minus predictions"),
            _ => (predicted - ceiling, "predictions minus ceiling"),
        };
        for (end, value, better, what) in [
            (
                "",
                predicted,
                better,
                "decoded predictions against true frames",
            ),
            (
                "_ceiling",
                ceiling,
                better,
                "frames encoded and decoded, against true frames",
            ),
            ("_gap", gap, Better::Lower, difference),
        ] {
            let about = format!("{about}: {what}. No interval: resampling it would take hours");
            let metric = Metric::plain(value, features.len(), better, &about);
            section.metric(&format!("{name}{end}"), metric);
        }
    }
    let vectors: usize = features.iter().map(|of| of.predicted.iter().count()).sum();
    let length = features.first().map_or(0, |of| of.predicted.length());
    let caution = match space {
        FeatureSpace::Jepa => "",
        _ => " A Fréchet distance of few vectors is too high: compare only equal numbers.",
    };
    section.notes.push(format!(
        "{}: {vectors} vectors of {length} features, of {} episodes.{caution}",
        space.name(),
        features.len()
    ));
}

fn frechet(
    features: &[&BySource<Vectors>],
    name: &'static str,
    about: &'static str,
) -> Result<Distance, MetricError> {
    let truth = moments(features.iter().map(|of| &of.truth))?;
    // Half a minute each with Inception's 2048 features.
    let (predicted, ceiling) = rayon::join(
        || frechet_distance(&moments(features.iter().map(|of| &of.predicted))?, &truth),
        || {
            frechet_distance(
                &moments(features.iter().map(|of| &of.reconstructed))?,
                &truth,
            )
        },
    );
    Ok(Distance {
        name,
        about,
        better: Better::Lower,
        predicted: predicted?,
        ceiling: ceiling?,
    })
}

fn jepa(features: &[&BySource<Vectors>]) -> Result<Vec<Distance>, MetricError> {
    let truth = table(features.iter().map(|of| &of.truth))?;
    let predicted = table(features.iter().map(|of| &of.predicted))?;
    let ceiling = table(features.iter().map(|of| &of.reconstructed))?;
    let discrepancy = |table: &Table| {
        let (kernel, estimator) = (PolynomialKernel::JEDI, Estimator::Biased);
        maximum_mean_discrepancy(table, &truth, kernel, estimator)
    };
    Ok(vec![
        Distance {
            name: "jepa_similarity",
            about: "JEPA similarity: exp(-40 MMD) of a JEPA's features, 0 to 1 (WorldArena's code)",
            better: Better::Higher,
            predicted: jepa_similarity(&predicted, &truth)?,
            ceiling: jepa_similarity(&ceiling, &truth)?,
        },
        Distance {
            name: "jepa_mmd",
            about: "squared maximum mean discrepancy of a JEPA's features, with JEDi's kernel; JEDi is 100 times this",
            better: Better::Lower,
            predicted: discrepancy(&predicted)?,
            ceiling: discrepancy(&ceiling)?,
        },
    ])
}

fn moments<'a>(vectors: impl Iterator<Item = &'a Vectors>) -> Result<Moments, MetricError> {
    let mut rows = vectors.flat_map(Vectors::iter).peekable();
    let mut all: Option<Moments> = None;
    while rows.peek().is_some() {
        let block = rows.by_ref().take(BLOCK).map(|row| row.iter().copied());
        let block = Moments::of(&Table::from_rows(block)?)?;
        all = Some(match all {
            Some(all) => all.merge(&block)?,
            None => block,
        });
    }
    all.ok_or(MetricError::Empty)
}

fn table<'a>(vectors: impl Iterator<Item = &'a Vectors>) -> Result<Table, MetricError> {
    let rows = vectors.flat_map(Vectors::iter);
    Table::from_rows(rows.map(|row| row.iter().copied()))
}
