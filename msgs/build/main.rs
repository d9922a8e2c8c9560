//! Writes the Rust types of all interfaces: those of this package (`msg/`, `srv/`, `action/`), and those of other packages
//! (`ros/PACKAGE/`). Each gets its structs and constants, and name, definition and dependencies as the crate's traits.
//!
//! `packages.rs` becomes part of the crate, one module for each package; `every.rs` gives its tests the lists of all types.

mod code;
mod interface;

use std::{env, error::Error, fs, path::PathBuf};

/// The crate's own parser of definitions.
#[allow(dead_code, reason = "the crate uses more of it")]
#[path = "../src/type_description"]
mod definitions {
    pub mod definition;
    pub mod error;
    pub mod field;
}

/// A failure of this script ends the build with its text.
type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    for folder in ["msg", "srv", "action", "ros"] {
        println!("cargo::rerun-if-changed={folder}");
    }
    let interfaces = code::Interfaces(interface::read_all()?);
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("packages.rs"), interfaces.packages()?)?;
    fs::write(out.join("every.rs"), interfaces.lists()?)?;
    Ok(())
}
