#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| roundel_fuzz::targets::picture::run(data));
