//! Runs ONNX files with tract.
//!
//! Tract plans a network for given input shapes. The last plan is kept, since metrics repeat shapes. It computes on the
//! calling thread, so results do not depend on the number of threads. Kernels depend on the processor, so the last bits
//! may differ.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use tract_onnx::prelude::{
    Arc, DatumType, Framework as _, InferenceFact, InferenceModel, InferenceModelExt as _,
    IntoRunnable as _, IntoTValue as _, TractResult, TypedRunnableModel,
};
use tract_onnx::tract_hir::infer::Factoid as _;
use tract_onnx::tract_hir::internal::DimLike as _;

use crate::onnx::network::Port;
use crate::onnx::{Error, Result, Role, Tensor};

/// A loaded file.
pub(crate) struct Session {
    model: InferenceModel,
    inputs: Vec<Port>,
    types: Vec<DatumType>,
    outputs: Vec<String>,
    plan: Mutex<Option<Plan>>,
}

/// A plan for input shapes.
#[derive(Clone)]
struct Plan {
    shapes: Vec<Vec<usize>>,
    network: Arc<TypedRunnableModel>,
}

impl Session {
    pub(crate) fn open(role: Role, file: &Path, bytes: Vec<u8>) -> Result<Self> {
        guarded(|| Self::load(&bytes)).map_err(|reason| Error::Unusable {
            role,
            file: file.to_owned(),
            reason,
        })
    }

    pub(crate) fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    pub(crate) fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// All outputs. Inputs must match the file in number and shape.
    pub(crate) fn run(&self, inputs: &[Tensor]) -> Result<Vec<Tensor>, String> {
        guarded(|| self.try_run(inputs))
    }

    fn load(bytes: &[u8]) -> TractResult<Self> {
        // Shapes in the file beyond the inputs often have another batch size; they follow from the inputs.
        let model = tract_onnx::onnx()
            .with_ignore_output_shapes(true)
            .with_ignore_value_info(true)
            .model_for_read(&mut &*bytes)?;
        let mut inputs = Vec::new();
        let mut types = Vec::new();
        for outlet in model.input_outlets()? {
            let fact = model.outlet_fact(*outlet)?;
            let sides = fact
                .shape
                .dims()
                .map(|side| side.concretize()?.to_usize().ok());
            inputs.push(Port {
                name: model.node(outlet.node).name.clone(),
                shape: (!fact.shape.is_open()).then(|| sides.collect()),
            });
            types.push(fact.datum_type.concretize().unwrap_or(DatumType::F32));
        }
        let outputs = model.output_outlets()?.iter().map(|outlet| {
            let name = &model.node(outlet.node).name;
            model.outlet_label(*outlet).unwrap_or(name).to_owned()
        });
        let session = Self {
            outputs: outputs.collect(),
            inputs,
            types,
            plan: Mutex::new(None),
            model,
        };
        // Finds unsupported operators early if the file fixes the shapes; else at the first run.
        let shapes: Option<Vec<Vec<usize>>> = session
            .inputs
            .iter()
            .map(|port| port.shape.as_ref()?.iter().copied().collect())
            .collect();
        if let Some(shapes) = shapes {
            session.plan_for(shapes)?;
        }
        Ok(session)
    }

    fn plan_for(&self, shapes: Vec<Vec<usize>>) -> TractResult<Arc<TypedRunnableModel>> {
        let kept = self
            .plan
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        if let Some(plan) = kept.filter(|plan| plan.shapes == shapes) {
            return Ok(plan.network);
        }
        let mut model = self.model.clone();
        for (index, (shape, datum_type)) in shapes.iter().zip(&self.types).enumerate() {
            model.set_input_fact(index, InferenceFact::dt_shape(*datum_type, shape))?;
        }
        let network = model.into_optimized()?.into_runnable()?;
        let plan = Plan {
            shapes,
            network: Arc::clone(&network),
        };
        *self.plan.lock().unwrap_or_else(PoisonError::into_inner) = Some(plan);
        Ok(network)
    }

    fn try_run(&self, inputs: &[Tensor]) -> TractResult<Vec<Tensor>> {
        let network = self.plan_for(inputs.iter().map(|input| input.shape().to_vec()).collect())?;
        let values = inputs.iter().zip(&self.types).map(|(input, datum_type)| {
            let tensor = tract_onnx::prelude::Tensor::from_shape(input.shape(), input.data())?;
            Ok(tensor.cast_to_dt(*datum_type)?.into_owned().into_tvalue())
        });
        let outputs = network.run(values.collect::<TractResult<_>>()?)?;
        let tensors = outputs.iter().map(|output| {
            let numbers = output.cast_to::<f32>()?;
            let data = numbers
                .to_plain_array_view::<f32>()?
                .iter()
                .copied()
                .collect();
            Ok(Tensor::new(output.shape().to_vec(), data))
        });
        // Shape and elements come from one array.
        Ok(tensors
            .collect::<TractResult<Vec<_>>>()?
            .into_iter()
            .flatten()
            .collect())
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session")
            .field("inputs", &self.inputs)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}

/// Converts errors of tract and their causes, and panics, to text: on a damaged file tract may index past an end or look up a
/// missing name. The panic's own message still goes to stderr.
fn guarded<T>(run: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    // No state is half changed after a panic: the plan is replaced whole, and the model is read-only.
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(done) => done.map_err(|error| format!("{error:#}")),
        Err(panic) => Err(format!("the runtime panicked: {}", message(&*panic))),
    }
}

fn message(panic: &(dyn Any + Send)) -> &str {
    match (panic.downcast_ref::<String>(), panic.downcast_ref::<&str>()) {
        (Some(text), _) => text,
        (_, Some(text)) => text,
        _ => "without a message",
    }
}
