//! Tests of the algorithms' public interface. They are one program, so that the crate is linked once; `cargo test -p
//! roundel-core --test main fusion::` runs one module.

mod code;
mod coded;
mod conventions;
mod detect;
mod drawing;
mod field_cases;
mod fusion;
mod golden;
mod hard_edges;
mod overexposed;
mod photo;
mod picture;
mod pixels;
mod precision;
mod rim_error;
mod shadow;
mod shared;
