//! Bias and rms of rim errors by size, tilt, blur, noise and margin; takes a minute:
//! `cargo bench -p roundel-core --bench precision`.

#[path = "../tests/drawing/mod.rs"]
mod drawing;
#[path = "../tests/rim_error/mod.rs"]
mod rim_error;

use rim_error::{cases, measure, print_head, print_row};

const SIZES_PX: [f64; 8] = [12.0, 16.0, 20.0, 30.0, 41.0, 60.0, 81.0, 110.0];
const PICTURES: u64 = 100;

fn main() {
    print_head();
    for kind_is_known in [true, false] {
        for margin in [1.4, 1.15] {
            for case in cases(&SIZES_PX, margin, kind_is_known) {
                print_row(&case, &measure(&case, PICTURES));
            }
        }
    }
}
