//! Time to render a simulated frame, and to create a renderer: `cargo bench -p roundel-core --bench sim`.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use roundel_core::sim::{Renderer, Scenario};

fn frames(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("sim");
    for (name, scenario) in [("r4_lite", Scenario::r4_lite(1)), ("r4", Scenario::r4(1))] {
        let mut renderers: Vec<Renderer> = (0..scenario.cameras().len())
            .map(|index| Renderer::new(&scenario, index).expect("a preset's camera"))
            .collect();
        let optics = &scenario.params().optics;
        let mut pixels = vec![0; optics.width * optics.height];
        let mut frame = 0;
        // All cameras in turn, for the mean over cameras.
        group.bench_function(format!("{name}/frame"), |bencher| {
            bencher.iter(|| {
                let camera = frame as usize % renderers.len();
                frame += 1;
                renderers[camera].render(frame, black_box(&mut pixels)).expect("a buffer that fits")
            });
        });
        group.sample_size(10);
        group.bench_function(format!("{name}/renderer"), |bencher| {
            bencher.iter(|| Renderer::new(black_box(&scenario), 0).expect("a preset's camera"));
        });
        group.sample_size(100);
    }
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
