//! Tests in real time, which a busy machine disturbs. They are a program of their own, since cargo runs one test program
//! after another.

mod chaos;
mod soak;
