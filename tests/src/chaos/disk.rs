//! Disk and clock of a server process, disturbed by a library that is preloaded into it (`faults.c`).

use std::{
    fs::{self, File},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use anyhow::{Context, ensure};

const LIBRARY: &str = include_str!("faults.c");

/// How the disk behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiskState {
    /// Without a fault.
    Works,
    /// Nothing more can be written.
    Full,
    /// Each call takes this long.
    Slow(Duration),
    /// Calls do not return.
    Hung,
}

/// Gives the preloaded library its orders.
#[derive(Debug)]
pub struct Disturbance {
    orders: File,
    orders_path: PathBuf,
    library: PathBuf,
}

impl Disturbance {
    /// Compiles the library with `cc` into this folder; everything works at first.
    pub fn new(folder: &Path) -> anyhow::Result<Self> {
        let (source, library) = (folder.join("faults.c"), folder.join("faults.so"));
        fs::write(&source, LIBRARY)?;
        let output = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .args([&library, &source])
            .output()
            .context("expected a C compiler: cc")?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "cc cannot compile faults.c: {errors}");
        let orders_path = folder.join("faults.orders");
        let orders = File::create(&orders_path)?;
        orders.write_all_at(&[0; 24], 0)?;
        Ok(Self { orders, orders_path, library })
    }

    /// Environment of the process.
    pub fn environment(&self) -> [(&'static str, &Path); 2] {
        [("LD_PRELOAD", &self.library), ("FAULTS_ORDERS", &self.orders_path)]
    }

    /// Changes the disk at once.
    pub fn set_disk(&self, state: DiskState) -> anyhow::Result<()> {
        let (number, delay) = match state {
            DiskState::Works => (0i64, Duration::ZERO),
            DiskState::Full => (1, Duration::ZERO),
            DiskState::Slow(delay) => (2, delay),
            DiskState::Hung => (3, Duration::ZERO),
        };
        self.orders.write_all_at(&(delay.as_micros() as i64).to_ne_bytes(), 8)?;
        Ok(self.orders.write_all_at(&number.to_ne_bytes(), 0)?)
    }

    /// Lets the disk work again after a time.
    pub fn repair_later(
        &self,
        after: Duration,
    ) -> anyhow::Result<impl Future<Output = ()> + use<>> {
        let orders = self.orders.try_clone()?;
        Ok(async move {
            tokio::time::sleep(after).await;
            // The file stays open, so this fails only with the test's own disk.
            let _ = orders.write_all_at(&0i64.to_ne_bytes(), 0);
        })
    }

    /// Sets the process's Unix clock off from this one's.
    pub fn set_clock_offset(&self, offset_ns: i64) -> anyhow::Result<()> {
        Ok(self.orders.write_all_at(&offset_ns.to_ne_bytes(), 16)?)
    }
}
