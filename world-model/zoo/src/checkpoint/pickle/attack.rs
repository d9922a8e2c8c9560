//! What no checkpoint has reason to import.

/// Modules whose functions run programs or code, or reach the network or the file system.
const MODULES: [&str; 18] = [
    "asyncio",
    "bdb",
    "commands",
    "ctypes",
    "importlib",
    "nt",
    "os",
    "pdb",
    "pip",
    "posix",
    "pty",
    "runpy",
    "shutil",
    "socket",
    "subprocess",
    "sys",
    "timeit",
    "webbrowser",
];

/// Python's own functions of that kind; others, as `getattr`, are what enumerations are pickled with.
const BUILTINS: [&str; 10] = [
    "__import__",
    "breakpoint",
    "compile",
    "eval",
    "exec",
    "execfile",
    "file",
    "globals",
    "input",
    "open",
];

/// Whether `module.name` is a function that attacks by pickles are known to call.
///
/// Nothing is called here, whatever it is. But whoever is given such a file is to hear of it before Python loads it.
/// The list is not complete, and cannot be.
pub(super) fn is_attack(module: &str, name: &str) -> bool {
    let package = module.split('.').next().unwrap_or(module);
    match package {
        "builtins" | "__builtin__" => BUILTINS.contains(&name),
        _ => MODULES.contains(&package),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_runs_commands_is_told_from_what_checkpoints_have() {
        for (module, name) in [
            ("os", "system"),
            ("posix", "system"),
            ("subprocess", "Popen"),
            ("importlib.util", "find_spec"),
            ("builtins", "eval"),
            ("__builtin__", "exec"),
        ] {
            assert!(is_attack(module, name), "{module}.{name}");
        }
        for (module, name) in [
            ("torch._utils", "_rebuild_tensor_v2"),
            ("collections", "OrderedDict"),
            ("builtins", "set"),
            ("builtins", "getattr"),
            ("argparse", "Namespace"),
            ("numpy.core.multiarray", "scalar"),
            ("pathlib", "PosixPath"),
            ("omegaconf.dictconfig", "DictConfig"),
            ("oslo", "x"),
        ] {
            assert!(!is_attack(module, name), "{module}.{name}");
        }
    }
}
