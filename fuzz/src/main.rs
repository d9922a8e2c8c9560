//! All targets as one libFuzzer program; `FUZZ_TARGET` names the one to run.

#![no_main]

use std::{env, process, sync::LazyLock};
use wm_fuzz::{TARGETS, Target};

static TARGET: LazyLock<Target> = LazyLock::new(|| {
    let name = env::var("FUZZ_TARGET").unwrap_or_else(|error| error.to_string());
    let Some((_, target)) = TARGETS.iter().find(|(known, _)| *known == name) else {
        let names = TARGETS.map(|(name, _)| name).join(", ");
        eprintln!("FUZZ_TARGET: expected one of {names}, got {name}");
        process::exit(2);
    };
    *target
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| TARGET(data));
