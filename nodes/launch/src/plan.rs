//! Resolves a launch file into processes: arguments, conditions, groups, substitutions, complete command lines. Starts
//! nothing.

mod process;
mod router;
mod surroundings;

pub(crate) use process::Output;
#[cfg(test)]
pub(crate) use process::Respawn;
pub use process::{Process, Program};
pub use router::Router;
pub use surroundings::{Surroundings, System};

use super::{
    error::LaunchError,
    file::{Action, ActionKind, Argument, LaunchFile},
    substitution::{Lookup, SubstitutionError, Template, parse_boolean},
};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The deepest nesting of includes: a deeper file most likely includes itself.
const INCLUDE_LIMIT: usize = 8;

/// The processes of a launch, in the file's order.
#[derive(Clone, Debug)]
pub struct Plan {
    /// In the order of the file.
    pub processes: Vec<Process>,
    /// The Zenoh router to start first; `None` from [`Self::resolve`].
    pub router: Option<Router>,
    /// Oddities that are not errors.
    pub warnings: Vec<String>,
}

impl Plan {
    /// Resolves `file` with the launch arguments of the command line.
    ///
    /// # Errors
    /// Names file, entry and key of a fault: a missing required argument, an undeclared argument, an unknown variable
    /// or package, a condition that is not a boolean.
    pub fn resolve(
        file: &LaunchFile,
        arguments: &BTreeMap<String, String>,
        surroundings: &dyn Surroundings,
    ) -> Result<Self, LaunchError> {
        let mut resolver = Resolver {
            surroundings,
            processes: Vec::new(),
            warnings: Vec::new(),
            declared: BTreeSet::new(),
        };
        let mut scope = Scope {
            variables: arguments.clone(),
            ..Scope::default()
        };
        resolver.visit(file, &file.actions, &mut scope, 0)?;
        if let Some(name) = arguments
            .keys()
            .find(|name| !resolver.declared.contains(*name))
        {
            return Err(LaunchError::UnknownArgument {
                file: file.path.clone(),
                name: name.clone(),
                declared: resolver.declared.into_iter().collect(),
            });
        }
        let mut names = BTreeSet::new();
        for process in &resolver.processes {
            if let Some(node) = &process.node
                && !names.insert(node)
            {
                resolver
                    .warnings
                    .push(format!("more than one node is named {node}"));
            }
        }
        Ok(Self {
            processes: resolver.processes,
            router: None,
            warnings: resolver.warnings,
        })
    }
}

/// Variables, environment and namespace of an action and its successors.
#[derive(Clone, Debug, Default)]
struct Scope {
    variables: BTreeMap<String, String>,
    /// Changes to the launcher's own environment; `None` removes.
    environment: BTreeMap<String, Option<String>>,
    namespace: Option<String>,
}

struct Resolver<'a> {
    surroundings: &'a dyn Surroundings,
    processes: Vec<Process>,
    warnings: Vec<String>,
    declared: BTreeSet<String>,
}

/// An action being resolved: its file and scope, and its name for errors.
struct Site<'a> {
    file: &'a Path,
    entry: &'a str,
    scope: &'a Scope,
    surroundings: &'a dyn Surroundings,
}

impl Site<'_> {
    fn resolve(&self, key: &str, template: &Template) -> Result<String, LaunchError> {
        template
            .resolve(self)
            .map_err(|source| self.substitution(key, source))
    }

    fn resolve_optional(
        &self,
        key: &str,
        template: Option<&Template>,
    ) -> Result<Option<String>, LaunchError> {
        template
            .map(|template| self.resolve(key, template))
            .transpose()
    }

    fn words(&self, key: &str, template: &Template) -> Result<Vec<String>, LaunchError> {
        template
            .resolve_words(self)
            .map_err(|source| self.substitution(key, source))
    }

    fn boolean(&self, key: &str, template: &Template) -> Result<bool, LaunchError> {
        parse_boolean(&self.resolve(key, template)?)
            .map_err(|source| self.substitution(key, source))
    }

    fn substitution(&self, key: &str, source: SubstitutionError) -> LaunchError {
        LaunchError::Substitution {
            file: self.file.to_owned(),
            entry: self.entry.to_owned(),
            key: key.to_owned(),
            source,
        }
    }

    fn error(&self, message: String) -> LaunchError {
        LaunchError::Entry {
            file: self.file.to_owned(),
            entry: self.entry.to_owned(),
            message,
        }
    }

    /// The folder of the launch file; never empty.
    fn folder(&self) -> PathBuf {
        match self.file.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        }
    }
}

impl Lookup for Site<'_> {
    fn variable(&self, name: &str) -> Option<String> {
        self.scope.variables.get(name).cloned()
    }

    fn environment(&self, name: &str) -> Option<String> {
        match self.scope.environment.get(name) {
            Some(change) => change.clone(),
            None => self.surroundings.environment(name),
        }
    }

    fn dirname(&self) -> String {
        self.folder().display().to_string()
    }

    fn filename(&self) -> String {
        self.file
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default()
    }

    fn package_share(&self, package: &str) -> Option<String> {
        let prefix = self.surroundings.package_prefix(package)?;
        Some(prefix.join("share").join(package).display().to_string())
    }

    fn package_prefix(&self, package: &str) -> Option<String> {
        self.surroundings
            .package_prefix(package)
            .map(|prefix| prefix.display().to_string())
    }
}

impl Resolver<'_> {
    fn visit(
        &mut self,
        file: &LaunchFile,
        actions: &[Action],
        scope: &mut Scope,
        includes: usize,
    ) -> Result<(), LaunchError> {
        for action in actions {
            let seen = scope.clone();
            let site = Site {
                file: &file.path,
                entry: &action.entry,
                scope: &seen,
                surroundings: self.surroundings,
            };
            let is_wanted = match (&action.only_if, &action.unless) {
                (Some(condition), _) => site.boolean("if", condition)?,
                (None, Some(condition)) => !site.boolean("unless", condition)?,
                (None, None) => true,
            };
            if is_wanted {
                self.act(file, &action.kind, &site, scope, includes)?;
            }
        }
        Ok(())
    }

    fn act(
        &mut self,
        file: &LaunchFile,
        kind: &ActionKind,
        site: &Site<'_>,
        scope: &mut Scope,
        includes: usize,
    ) -> Result<(), LaunchError> {
        match kind {
            ActionKind::Argument(argument) => {
                let value = argument_value(argument, site)?;
                self.declared.insert(argument.name.clone());
                scope.variables.insert(argument.name.clone(), value);
            }
            ActionKind::Let { name, value } => {
                scope
                    .variables
                    .insert(site.resolve("name", name)?, site.resolve("value", value)?);
            }
            ActionKind::Environment { name, value } => {
                let value = site.resolve_optional("value", value.as_ref())?;
                scope.environment.insert(site.resolve("name", name)?, value);
            }
            ActionKind::PushNamespace(namespace) => {
                let namespace = site.resolve("namespace", namespace)?;
                scope.namespace =
                    process::join_namespaces(scope.namespace.as_deref(), Some(&namespace));
            }
            ActionKind::Group {
                scoped: true,
                actions,
            } => {
                self.visit(file, actions, &mut site.scope.clone(), includes)?;
            }
            ActionKind::Group {
                scoped: false,
                actions,
            } => self.visit(file, actions, scope, includes)?,
            ActionKind::Include {
                file: included,
                arguments,
            } => {
                self.include(
                    &site.resolve("file", included)?,
                    arguments,
                    site,
                    scope,
                    includes,
                )?;
            }
            ActionKind::Node(node) => {
                let process = process::node(node, site, self.processes.len())?;
                self.processes.push(process);
            }
            ActionKind::Executable { command, process } => {
                let process = process::executable(command, process, site, self.processes.len())?;
                self.processes.push(process);
            }
        }
        Ok(())
    }

    fn include(
        &mut self,
        path: &str,
        arguments: &[(Template, Template)],
        site: &Site<'_>,
        scope: &mut Scope,
        includes: usize,
    ) -> Result<(), LaunchError> {
        if includes >= INCLUDE_LIMIT {
            return Err(site.error(format!(
                "launch files include each other more than {INCLUDE_LIMIT} deep"
            )));
        }
        // as in ROS 2: relative to the working directory, and the included file's variables remain
        let path = PathBuf::from(path);
        let text = self
            .surroundings
            .read(&path)
            .map_err(|source| LaunchError::Read {
                file: path.clone(),
                source,
            })?;
        let included = LaunchFile::parse(&path, &text)?;
        for (name, value) in arguments {
            scope.variables.insert(
                site.resolve("arg name", name)?,
                site.resolve("arg value", value)?,
            );
        }
        self.visit(&included, &included.actions, scope, includes + 1)
    }
}

fn argument_value(argument: &Argument, site: &Site<'_>) -> Result<String, LaunchError> {
    let value = match (site.scope.variables.get(&argument.name), &argument.default) {
        (Some(given), _) => given.clone(),
        (None, Some(default)) => site.resolve("default", default)?,
        (None, None) => {
            let what = argument
                .description
                .as_deref()
                .unwrap_or("no description given");
            return Err(site.error(format!(
                "launch argument {:?} ({what}) has no default: give it as {}:=VALUE",
                argument.name, argument.name
            )));
        }
    };
    if !argument.choices.is_empty() && !argument.choices.contains(&value) {
        return Err(site.error(format!(
            "launch argument {:?} is {value:?}; expected one of: {}",
            argument.name,
            argument.choices.join(", ")
        )));
    }
    Ok(value)
}

#[cfg(test)]
mod tests;
