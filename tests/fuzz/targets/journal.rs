#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| holosonar_fuzz::journal(data));
