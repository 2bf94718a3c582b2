//! The server under test: in this process, or in one of its own.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicI64, Ordering},
    },
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};
use roundel_server::{app::serve, model::config::Config};
use tokio::{task::block_in_place, time::timeout};

use super::{disk::Disturbance, link::CurrentAddress, timetable::Stage, world::World};
use crate::process;

/// The server stops within 5 s. A busy machine may take longer to schedule that.
pub const STOP: Duration = Duration::from_secs(8);

enum Running {
    Library(Box<serve::Server>),
    Process(process::Server),
}

/// Starts, kills and stops servers with one configuration.
pub struct Host {
    config: PathBuf,
    world: Arc<World>,
    /// Where the server listens.
    pub address: CurrentAddress,
    /// Its clock against the world's.
    pub offset_ns: Arc<AtomicI64>,
    /// Controls the disk and the clock of a real process. `None` in [`Stage::Library`].
    pub disturbance: Option<Disturbance>,
    clock_step_ns: i64,
    running: Option<Running>,
    /// What earlier processes logged.
    pub log: String,
}

impl Host {
    /// Nothing runs yet; the folder has `lab.toml`.
    pub fn new(stage: Stage, world: Arc<World>, folder: &Path) -> anyhow::Result<Self> {
        let disturbance = match stage {
            Stage::Library => None,
            Stage::Process => Some(Disturbance::new(folder)?),
        };
        Ok(Self {
            config: folder.join("lab.toml"),
            world,
            address: CurrentAddress::default(),
            offset_ns: Arc::default(),
            disturbance,
            clock_step_ns: 0,
            running: None,
            log: String::new(),
        })
    }

    /// Sets the clock of the server's computer. A running server keeps its own time.
    pub fn step_clock(&mut self, by_ns: i64) -> anyhow::Result<()> {
        self.clock_step_ns += by_ns;
        let disturbance = self.disturbance.as_ref().context("expected a process")?;
        disturbance.set_clock_offset(self.clock_step_ns)
    }

    /// Starts a server; waits until it listens.
    pub async fn start(&mut self) -> anyhow::Result<()> {
        let Some(disturbance) = &self.disturbance else {
            let config = Config::load(&self.config).context("at a start")?;
            let server = serve::Server::start(config).await?;
            let now = Instant::now();
            let offset_ns = server.clock().at(now).ns_since(self.world.at(now));
            self.offset_ns.store(offset_ns, Ordering::Relaxed);
            self.address.set(server.local_addr());
            self.running = Some(Running::Library(Box::new(server)));
            return Ok(());
        };
        let config = self.config.to_string_lossy();
        let folder = self.config.parent().unwrap_or(Path::new("."));
        let arguments = ["serve", "--config", &config];
        self.offset_ns.store(self.clock_step_ns, Ordering::Relaxed);
        let environment = disturbance.environment();
        let server =
            block_in_place(|| process::Server::start_with(&arguments, folder, &environment))?;
        let address: SocketAddr = server.address().parse()?;
        self.address.set(address);
        self.running = Some(Running::Process(server));
        Ok(())
    }

    /// Ends a process without warning.
    pub fn kill(&mut self) -> anyhow::Result<()> {
        if let Some(Running::Process(mut server)) = self.running.take() {
            server.signal("KILL")?;
            block_in_place(|| server.wait(STOP))?;
            self.log += &server.log();
        }
        Ok(())
    }

    /// Stops the server; returns how long that took.
    pub async fn stop(&mut self) -> anyhow::Result<Duration> {
        let started = Instant::now();
        match self.running.take() {
            Some(Running::Library(server)) => {
                timeout(STOP, server.shutdown()).await.context("the server does not stop")?;
            }
            Some(Running::Process(mut server)) => {
                server.signal("TERM")?;
                let ended = block_in_place(|| server.wait(STOP));
                self.log += &server.log();
                // A disk that hangs ends the process with an error; in time is what counts.
                ended?;
            }
            None => {}
        }
        ensure!(started.elapsed() < STOP, "the server took {:?} to stop", started.elapsed());
        Ok(started.elapsed())
    }

    /// Whether a process has ended although it should run.
    pub fn has_ended(&mut self) -> bool {
        match &mut self.running {
            Some(Running::Process(server)) => server.has_ended(),
            _ => false,
        }
    }

    /// All that processes logged.
    pub fn whole_log(&self) -> String {
        match &self.running {
            Some(Running::Process(server)) => format!("{}{}", self.log, server.log()),
            _ => self.log.clone(),
        }
    }
}
