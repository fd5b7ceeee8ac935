#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| holosonar_fuzz::set(data));
holosonar_fuzz::mutator!("toml");
