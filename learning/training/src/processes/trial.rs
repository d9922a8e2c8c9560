use std::sync::{Arc, mpsc::Receiver};

use super::order::Reply;
use crate::gradient_tree::Node;

/// Largest relative error of a worker's gradient. Formats of eight bits differ by less; other data or another network by
/// about 1.
const LARGEST_ERROR: f64 = 0.05;

/// A batch that a worker and the coordinator both compute: it checks the worker, and measures its speed.
#[derive(Debug)]
pub struct Trial {
    /// The coordinator's result.
    pub reference: Arc<Node>,
    /// The worker's result.
    pub reply: Receiver<Reply>,
}

/// Comparison of a worker's result with the coordinator's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// The same bytes.
    Exact,
    /// Other rounding, with this relative error of the gradient.
    Rounded(f64),
    /// Another result, with this relative error of the gradient.
    Wrong(f64),
}

/// Compares results; `None` if the coordinator's is not finite.
pub fn verdict(reference: &Node, found: &Node) -> Option<Verdict> {
    let gradient = |node: &Node| -> Vec<f32> { node.sum.gradient.concat() };
    let (own, theirs) = (gradient(reference), gradient(found));
    let (own_loss, their_loss) = ([reference.sum.loss], [found.sum.loss]);
    let error = relative_error(&own, &theirs)?.max(relative_error(&own_loss, &their_loss)?);
    let bits =
        |values: &[f32]| -> Vec<u32> { values.iter().map(|value| value.to_bits()).collect() };
    let is_exact = bits(&own) == bits(&theirs) && bits(&own_loss) == bits(&their_loss);
    Some(match () {
        () if is_exact => Verdict::Exact,
        () if error <= LARGEST_ERROR => Verdict::Rounded(error),
        () => Verdict::Wrong(error),
    })
}

/// Norm of the difference over the norm of `expected`, infinite for a result that is not finite; `None` if `expected` is
/// not finite.
fn relative_error(expected: &[f32], found: &[f32]) -> Option<f64> {
    let norm = |values: &mut dyn Iterator<Item = f64>| {
        values.map(|value| value * value).sum::<f64>().sqrt()
    };
    let length = norm(&mut expected.iter().map(|value| f64::from(*value)));
    let differences = expected.iter().zip(found);
    let mut differences = differences.map(|(own, theirs)| f64::from(*own) - f64::from(*theirs));
    let error = norm(&mut differences) / length.max(f64::MIN_POSITIVE);
    length.is_finite().then(|| match error.is_finite() {
        true => error,
        false => f64::INFINITY,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{gradient_tree::Place, run::StepLoss};

    fn node(loss: f32, gradient: &[f32]) -> Node {
        Node {
            place: Place { level: 0, index: 0 },
            sum: StepLoss {
                loss,
                parts: Vec::new(),
                gradient: vec![gradient.to_vec()],
            },
        }
    }

    #[test]
    fn rounding_is_told_from_another_result() {
        let own = node(0.5, &[3.0, -4.0]);
        assert_eq!(verdict(&own, &own), Some(Verdict::Exact));
        let rounded = verdict(&own, &node(0.5, &[3.0, -4.000_001]));
        assert!(matches!(rounded, Some(Verdict::Rounded(error)) if error < 1e-6));
        for other in [node(0.5, &[3.0, 4.0]), node(f32::NAN, &[3.0, -4.0])] {
            assert!(matches!(verdict(&own, &other), Some(Verdict::Wrong(_))));
        }
        assert_eq!(verdict(&node(f32::NAN, &[3.0]), &own), None);
    }
}
