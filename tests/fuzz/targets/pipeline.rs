#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| holosonar_fuzz::pipeline(data));
holosonar_fuzz::mutator!("toml");
