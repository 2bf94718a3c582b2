//! What requests may make the server open: files in some folders, cameras of this machine, and addresses in some
//! networks.
//!
//! The rules bind the sources and files that a request names. Those of the configuration file are the operator's, and
//! nothing binds them. A change by a request is written to that file, so a camera that a request has added is bound until
//! the server restarts.
//!
//! A path is compared after its symbolic links are resolved, and an error does not depend on whether the file exists. A
//! host name is resolved each time that a source connects, and only to addresses that passed [`SourceRules::allows`], so
//! a name whose address changes after the check gains nothing.

use std::{
    net::{IpAddr, Ipv4Addr},
    path::{self, Component, Path, PathBuf},
};

use ipnet::IpNet;
use thiserror::Error;

use super::address::{ImagesAddress, MediaAddress, SourceAddress, split_pattern};

/// Networks of cameras: private, link-local, and this machine.
pub const DEFAULT_NETWORKS: [&str; 8] = [
    "10.0.0.0/8",
    "172.16.0.0/12",
    "192.168.0.0/16",
    "169.254.0.0/16",
    "127.0.0.0/8",
    "fc00::/7",
    "fe80::/10",
    "::1/128",
];

/// Address of the metadata service of cloud providers, which gives credentials to anyone who asks. It lies among the
/// link-local addresses, and is allowed only if it is configured as a network of its own.
const METADATA_SERVICE: IpAddr = IpAddr::V4(Ipv4Addr::new(169, 254, 169, 254));

#[derive(Clone, Debug, Default, PartialEq)]
pub struct SourceRules {
    pub folders: Vec<PathBuf>,
    pub networks: Vec<IpNet>,
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SourceRuleError {
    #[error(
        "{} is in no folder whose files clients may name: put the file beside the configuration file, or add its folder to \
         `source_folders` under [server] there and restart the server",
        .0.display()
    )]
    Folder(PathBuf),
    #[error("a pattern that a client names must not have `..` after a wildcard")]
    Parent,
    #[error(
        "{0} is in no network whose cameras clients may name: add it to `source_networks` under [server] in the \
         configuration file, and restart the server"
    )]
    Network(String),
    #[error(
        "{} is no camera that clients may name: expected /dev/video0 or the like, or a link to it; write any other device \
         into the configuration file, and restart the server",
        .0.display()
    )]
    Device(PathBuf),
    #[error(
        "`gst:` can run any pipeline on the server, so clients cannot set it: write this source into the configuration \
         file, and restart the server"
    )]
    Pipeline,
}

impl SourceRules {
    /// Checks everything of a source that is known before it is opened.
    pub fn check(&self, address: &SourceAddress) -> Result<(), SourceRuleError> {
        match address {
            SourceAddress::Images(images) => self.check_images(images),
            SourceAddress::Media(MediaAddress::File { path, .. }) => self.check_file(path),
            SourceAddress::Media(MediaAddress::Pipeline(_)) => Err(SourceRuleError::Pipeline),
            SourceAddress::Media(MediaAddress::Rtsp { host, .. }) => self.check_host(host),
            SourceAddress::Http(http) => self.check_host(&http.host),
            SourceAddress::Device(device) => check_device(&device.path),
            SourceAddress::Sim(_) | SourceAddress::Push(_) => Ok(()),
        }
    }

    fn check_images(&self, images: &ImagesAddress) -> Result<(), SourceRuleError> {
        let (root, wildcards) = split_pattern(&images.pattern);
        self.check_file(&root)?;
        if Path::new(&images.pattern).is_dir() {
            self.check_file(Path::new(&images.pattern))?;
        }
        let is_name = |it: Component<'_>| matches!(it, Component::Normal(_));
        if !wildcards.components().all(is_name) {
            return Err(SourceRuleError::Parent);
        }
        images.times.as_ref().map_or(Ok(()), |times| self.check_file(times))
    }

    /// Whether a file is in one of the folders.
    pub fn check_file(&self, path: &Path) -> Result<(), SourceRuleError> {
        let folders = self.resolved_folders();
        let is_inside = resolve(path).is_some_and(|path| starts_with_any(&path, &folders));
        is_inside.then_some(()).ok_or_else(|| SourceRuleError::Folder(path.to_owned()))
    }

    /// Drops the files that are in none of the folders, such as the targets of symbolic links.
    pub fn retain_inside(&self, files: &mut Vec<PathBuf>) {
        let folders = self.resolved_folders();
        let is_inside =
            |file: &PathBuf| file.canonicalize().is_ok_and(|file| starts_with_any(&file, &folders));
        files.retain(is_inside);
    }

    fn resolved_folders(&self) -> Vec<PathBuf> {
        self.folders.iter().filter_map(|folder| folder.canonicalize().ok()).collect()
    }

    /// Checks a host that is an address; a name is checked when it is resolved.
    fn check_host(&self, host: &str) -> Result<(), SourceRuleError> {
        match host.parse::<IpAddr>() {
            Ok(address) if !self.allows(address) => Err(SourceRuleError::Network(host.to_owned())),
            _ => Ok(()),
        }
    }

    /// Whether a source may connect to an address.
    pub fn allows(&self, address: IpAddr) -> bool {
        // An IPv4 address may be written as one of IPv6.
        let address = address.to_canonical();
        let is_single = |network: &IpNet| network.prefix_len() == network.max_prefix_len();
        let mut networks = self.networks.iter().filter(|network| network.contains(&address));
        networks.any(|network| address != METADATA_SERVICE || is_single(network))
    }
}

fn check_device(path: &Path) -> Result<(), SourceRuleError> {
    let is_camera = |path: PathBuf| {
        let text = path.to_string_lossy();
        let number = text.strip_prefix("/dev/video");
        number.is_some_and(|it| !it.is_empty() && it.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let is_camera = resolve(path).is_some_and(is_camera);
    is_camera.then_some(()).ok_or_else(|| SourceRuleError::Device(path.to_owned()))
}

fn starts_with_any(path: &Path, folders: &[PathBuf]) -> bool {
    folders.iter().any(|folder| path.starts_with(folder))
}

/// A path without symbolic links and `..`, of which the last components may not exist yet.
fn resolve(path: &Path) -> Option<PathBuf> {
    let absolute = path::absolute(path).ok()?;
    let (mut existing, mut missing) = (absolute.as_path(), Vec::new());
    loop {
        if let Ok(found) = existing.canonicalize() {
            return Some(missing.into_iter().rev().fold(found, |path, name| path.join(name)));
        }
        // A link whose target cannot be resolved may lead anywhere later.
        if existing.is_symlink() {
            return None;
        }
        missing.push(existing.file_name()?);
        existing = existing.parent()?;
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::symlink};

    use super::*;

    fn rules(folder: &Path) -> SourceRules {
        let networks = DEFAULT_NETWORKS.iter().map(|network| network.parse().unwrap()).collect();
        SourceRules { folders: vec![folder.to_owned()], networks }
    }

    fn check(rules: &SourceRules, source: &str, folder: &Path) -> Result<(), SourceRuleError> {
        rules.check(&SourceAddress::parse(source, folder).unwrap())
    }

    #[test]
    fn paths_that_lead_out_of_the_folders_are_refused_whether_or_not_they_exist() {
        let all = tempfile::tempdir().unwrap();
        let (lab, other) = (all.path().join("lab"), all.path().join("other"));
        for folder in [&lab, &other, &lab.join("frames")] {
            fs::create_dir_all(folder).unwrap();
        }
        fs::write(other.join("secret.png"), "").unwrap();
        fs::write(lab.join("frames/0.png"), "").unwrap();
        symlink(&other, lab.join("out")).unwrap();
        symlink(all.path().join("later"), lab.join("dangling")).unwrap();
        let rules = rules(&lab);
        for source in [
            "images:frames/*.png",
            "images:none/yet/*.png?times=times.txt",
            "images:frames/../frames",
            "images:**/*.png",
            "file:run.mp4",
        ] {
            assert_eq!(check(&rules, source, &lab), Ok(()), "{source}");
        }
        for source in [
            "images:/etc/passwd",
            "images:/etc/none",
            "images:/**/*",
            "images:../other/*.png",
            "images:out/*.png",
            "images:out",
            "images:dangling/*.png",
            "images:none/../../other/*.png",
            "images:frames/*.png?times=/etc/passwd",
            "images:frames/*.png?times=out/times.txt",
            "file:/etc/passwd",
            "file:out/secret.png",
        ] {
            let error = check(&rules, source, &lab).expect_err(source);
            assert!(matches!(error, SourceRuleError::Folder(_)), "{source}: {error}");
        }
        let error = check(&rules, "images:frames/*/../../../etc/*", &lab);
        assert_eq!(error, Err(SourceRuleError::Parent));
        // A link that a wildcard matches.
        let mut files = vec![lab.join("frames/0.png"), lab.join("out/secret.png")];
        rules.retain_inside(&mut files);
        assert_eq!(files, [lab.join("frames/0.png")]);
        let nowhere = SourceRules { folders: Vec::new(), ..rules };
        assert!(check(&nowhere, "images:frames/*.png", &lab).is_err());
    }

    #[test]
    fn addresses_outside_of_the_networks_pipelines_and_other_devices_are_refused() {
        let rules = rules(Path::new("/lab"));
        for source in [
            "http://192.168.1.20/stream",
            "http://127.0.0.1:81/",
            "http://[fe80::1]/",
            "http://camera.example/",
            "rtsp://u:p@10.0.0.2:8554/live",
            "push:",
            "sim:",
            "v4l2:/dev/video0",
            "v4l2:/dev/../dev/video12",
        ] {
            assert_eq!(check(&rules, source, Path::new("/lab")), Ok(()), "{source}");
        }
        for (source, expected) in [
            ("http://8.8.8.8/", "8.8.8.8 is in no network"),
            ("http://0.0.0.0/", "0.0.0.0 is in no network"),
            ("http://[2001:db8::1]/", "2001:db8::1 is in no network"),
            ("http://[::ffff:8.8.8.8]/", "is in no network"),
            ("http://169.254.169.254/", "169.254.169.254 is in no network"),
            ("rtsp://8.8.8.8/live", "8.8.8.8 is in no network"),
            ("rtsp://[2001:db8::1]:554/live", "2001:db8::1 is in no network"),
            ("gst:videotestsrc", "write this source into the configuration file"),
            ("v4l2:/dev/ptmx", "/dev/ptmx is no camera"),
            ("v4l2:/dev/video", "is no camera"),
            ("v4l2:/dev/video0/../watchdog", "is no camera"),
            ("v4l2:/etc/passwd", "/etc/passwd is no camera"),
            ("v4l2:/etc/none", "/etc/none is no camera"),
        ] {
            let error = check(&rules, source, Path::new("/lab")).expect_err(source).to_string();
            assert!(error.contains(expected), "{source}: {error}");
        }
        assert!(rules.allows("::ffff:10.0.0.1".parse().unwrap()));
        assert!(!rules.allows("::ffff:8.8.8.8".parse().unwrap()));
        let metadata =
            SourceRules { networks: vec!["169.254.169.254/32".parse().unwrap()], ..rules };
        assert!(metadata.allows(METADATA_SERVICE));
    }
}
