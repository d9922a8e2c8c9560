#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| wm_fuzz::definition(data));
