//! Finding the tensors in a pickled object.
//!
//! What a tensor looks like: torch/_utils.py (`_rebuild_tensor_v2`, `_rebuild_parameter`) and torch/_tensor.py
//! (`_rebuild_from_type_v2`).

use super::Element;
use super::pickle::{Id, Pickle, Value};

/// Dictionaries nested deeper than this are not looked into.
const MAX_DEPTH: usize = 12;

/// More objects than this are no checkpoint's, but a pickle's that refers to itself.
const MAX_VISITS: usize = 250_000;

/// As many items are looked at in all of them: a long list that is there many times takes as many looks.
const MAX_ITEMS: usize = 16_000_000;

/// Longest path of keys to a tensor, in bytes.
const MAX_PATH: usize = 1024;

/// What a module keeps its tensors and its parts in, which is not part of their names.
const IN_MODULES: [&str; 3] = ["_parameters", "_buffers", "_modules"];

/// Wrappers around one tensor (a parameter of a subclass of a tensor ..) that are taken off.
const MAX_WRAPPERS: usize = 4;

/// A tensor as the pickle describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Stored<'a> {
    pub(super) element: Element,
    /// Name of the file in the archive that holds its values, and maybe others'.
    pub(super) storage: &'a str,
    /// Of its first value in the storage, in values.
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    /// In values.
    pub(super) strides: Vec<usize>,
}

/// All tensors in dictionaries and lists, and in the modules of TorchScript or of a pickled network, named by the path
/// of keys to them. Tensors of a kind that is not known (sparse, quantised) are passed over.
pub(super) fn tensors<'a>(pickle: &Pickle<'a>) -> Result<Vec<(String, Stored<'a>)>, String> {
    let mut walk = Walk {
        pickle,
        todo: vec![(String::new(), pickle.root(), 0)],
        visits: 0,
        items: 0,
    };
    let mut found = Vec::new();
    while let Some((path, id, depth)) = walk.todo.pop() {
        match pickle.get(id) {
            Value::Dict(items) => walk.descend_into(&path, depth, items)?,
            Value::Sequence(items) => {
                for (i, value) in items.iter().enumerate() {
                    walk.descend(&path, depth, &i.to_string(), *value)?;
                }
            }
            Value::Call { state, .. } => {
                if let Some(tensor) = tensor(pickle, id)? {
                    found.push((path, tensor));
                } else if let Some(state) = state
                    && let Value::Dict(items) = pickle.get(*state)
                {
                    walk.descend_into(&path, depth, items)?;
                }
            }
            _ => {}
        }
    }
    Ok(found)
}

/// A walk through all that a pickled object holds, within bounds.
struct Walk<'p, 'a> {
    pickle: &'p Pickle<'a>,
    /// What is still to be looked at: its path, what it is, and how deep it lies.
    todo: Vec<(String, Id, usize)>,
    visits: usize,
    items: usize,
}

impl Walk<'_, '_> {
    /// Has the values of a dictionary looked at, those whose keys are texts or numbers.
    fn descend_into(&mut self, path: &str, depth: usize, items: &[(Id, Id)]) -> Result<(), String> {
        for (key, value) in items {
            match self.pickle.get(*key) {
                Value::Text(name) => self.descend(path, depth, name, *value)?,
                Value::Int(name) => self.descend(path, depth, &name.to_string(), *value)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// Has the value `name` of what lies at `path` looked at, if there can be tensors in it.
    fn descend(&mut self, path: &str, depth: usize, name: &str, id: Id) -> Result<(), String> {
        self.items += 1;
        if self.items > MAX_ITEMS {
            return Err(format!("more than {MAX_ITEMS} items: it refers to itself"));
        }
        let holds_more = matches!(
            self.pickle.get(id),
            Value::Dict(_) | Value::Sequence(_) | Value::Call { .. }
        );
        if !holds_more || depth >= MAX_DEPTH {
            return Ok(());
        }
        self.visits += 1;
        if self.visits > MAX_VISITS {
            return Err(format!(
                "more than {MAX_VISITS} objects: it refers to itself"
            ));
        }
        let length = path.len() + 1 + name.len();
        if length > MAX_PATH {
            return Err(format!(
                "a path of {length} bytes, expected at most {MAX_PATH}"
            ));
        }
        let path = match path {
            path if IN_MODULES.contains(&name) => path.to_owned(),
            "" => name.to_owned(),
            path => format!("{path}.{name}"),
        };
        self.todo.push((path, id, depth + 1));
        Ok(())
    }
}

/// The tensor that a call makes, if it makes one.
fn tensor<'a>(pickle: &Pickle<'a>, id: Id) -> Result<Option<Stored<'a>>, String> {
    let Value::Call {
        callable,
        arguments,
        ..
    } = pickle.get(id)
    else {
        return Ok(None);
    };
    let (mut callable, mut arguments) = (*callable, *arguments);
    for _ in 0..MAX_WRAPPERS {
        let Value::Global { module, name } = *pickle.get(callable) else {
            return Ok(None);
        };
        if !matches!(module, "torch._utils" | "torch._tensor") {
            return Ok(None);
        }
        let items = sequence(pickle, arguments)?;
        match (module, name, items) {
            ("torch._utils", "_rebuild_tensor_v2" | "_rebuild_tensor", items) => {
                return rebuilt(pickle, items);
            }
            // (the tensor, ..)
            (
                "torch._utils",
                "_rebuild_parameter" | "_rebuild_parameter_with_state",
                [inner, ..],
            ) => {
                let Value::Call {
                    callable: of,
                    arguments: with,
                    ..
                } = pickle.get(*inner)
                else {
                    return Ok(None);
                };
                (callable, arguments) = (*of, *with);
            }
            // (function, type, its arguments, state)
            ("torch._tensor", "_rebuild_from_type_v2", [of, _, with, ..]) => {
                (callable, arguments) = (*of, *with);
            }
            _ => return Ok(None),
        }
    }
    Ok(None)
}

/// A tensor from (storage, offset, shape, strides, ..).
fn rebuilt<'a>(pickle: &Pickle<'a>, items: &[Id]) -> Result<Option<Stored<'a>>, String> {
    let [storage, offset, shape, strides, ..] = items else {
        return Err(format!(
            "a tensor of {} arguments, expected 4 or more",
            items.len()
        ));
    };
    let Value::Persistent(storage) = pickle.get(*storage) else {
        return Err("a tensor without a storage".to_owned());
    };
    // ("storage", type, name, device, number of values)
    let [_, kind, name, ..] = sequence(pickle, *storage)? else {
        return Err("a storage without type and name".to_owned());
    };
    let (Value::Global { name: class, .. }, Value::Text(storage)) =
        (pickle.get(*kind), pickle.get(*name))
    else {
        return Err("a storage without type and name".to_owned());
    };
    let Some(element) = Element::of_torch_storage(class) else {
        return Ok(None);
    };
    Ok(Some(Stored {
        element,
        storage,
        offset: size(pickle, *offset)?,
        shape: sizes(pickle, *shape)?,
        strides: sizes(pickle, *strides)?,
    }))
}

fn sequence<'p>(pickle: &'p Pickle<'_>, id: Id) -> Result<&'p [Id], String> {
    match pickle.get(id) {
        Value::Sequence(items) => Ok(items),
        other => Err(format!("expected a tuple, got {other}")),
    }
}

fn sizes(pickle: &Pickle<'_>, id: Id) -> Result<Vec<usize>, String> {
    let items = sequence(pickle, id)?;
    items.iter().map(|item| size(pickle, *item)).collect()
}

fn size(pickle: &Pickle<'_>, id: Id) -> Result<usize, String> {
    let Value::Int(value) = pickle.get(id) else {
        return Err(format!("expected a size, got {}", pickle.get(id)));
    };
    usize::try_from(*value).map_err(|_| format!("a size of {value}"))
}
