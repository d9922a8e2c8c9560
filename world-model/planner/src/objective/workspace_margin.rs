//! Cost of positions near the limits of the workspace.

use candle_core::Tensor;

use super::{PortableTerm, Term, action_size::mean};
use crate::{PlanError, SearchSpace};

/// Mean squared intrusion of the end effector into the margin along the workspace's limits, as a share of the margin: 0
/// inside, 1 at a limit. 0 without a workspace.
#[derive(Clone, Copy, Debug)]
pub struct WorkspaceMargin {
    /// Width of the margin \[m\], above 0.
    pub margin: f64,
}

impl Term for WorkspaceMargin {
    fn name(&self) -> &'static str {
        "workspace"
    }

    fn portable(&self) -> wm_model::Result<Option<PortableTerm>> {
        Ok(Some(PortableTerm::WorkspaceMargin {
            margin: self.margin,
        }))
    }

    fn costs(
        &self,
        space: &SearchSpace,
        candidates: &[Vec<f32>],
        _: &Tensor,
    ) -> Result<Vec<f32>, PlanError> {
        let Some(workspace) = space.workspace() else {
            return Ok(vec![0.0; candidates.len()]);
        };
        let cost = |candidate: &Vec<f32>| {
            mean(workspace.axes.iter().flat_map(|axis| {
                let values = candidate.iter().skip(axis.coordinate).step_by(space.len());
                values.scan(axis.position, |position, value| {
                    *position += f64::from(*value) * axis.metres;
                    Some((axis.beyond(*position, self.margin) / self.margin) as f32)
                })
            }))
        };
        Ok(candidates.iter().map(cost).collect())
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;
    use crate::{Workspace, WorkspaceAxis};

    #[test]
    fn only_positions_in_the_margin_cost() {
        let axes = vec![WorkspaceAxis {
            coordinate: 0,
            metres: 0.1,
            position: 0.2,
            range: (0.0, 0.4),
        }];
        let space = SearchSpace::bounded(&[(-2.0, 2.0)], 1).unwrap();
        let latents = Tensor::zeros((2, 1, 1, 1, 1), DType::F32, &Device::Cpu).unwrap();
        let term = WorkspaceMargin { margin: 0.05 };
        let candidates = [vec![1.0], vec![2.0]];
        assert_eq!(term.costs(&space, &candidates, &latents).unwrap(), [0.0; 2]);
        let space = space.within(Workspace { axes }).unwrap();
        let costs = term.costs(&space, &candidates, &latents).unwrap();
        assert_eq!(costs[0], 0.0);
        assert!((costs[1] - 1.0).abs() < 1e-6, "{costs:?}");
    }
}
