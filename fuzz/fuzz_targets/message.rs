#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| servocrab_fuzz::targets::message::run(data));
