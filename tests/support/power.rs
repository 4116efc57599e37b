//! A disk in memory that promises what [`terraquilt::store::disk`] assumes and no more, and a catalog whose transactions
//! are steps like its writes: power can be cut at any of them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex};
use terraquilt::base::{Error, Result};
use terraquilt::db::Db;
use terraquilt::store::catalog::{Catalog, Commit, Counters, NamedFile, Sqlite, Version};
use terraquilt::store::disk::{Disk, Finished, Growing};

/// Bytes of a file, and how many of them are durable.
#[derive(Clone, Default)]
struct Inode {
    bytes: Vec<u8>,
    durable: usize,
}

#[derive(Clone, Default)]
struct State {
    inodes: Vec<Inode>,
    /// Names as running programs see them.
    live: BTreeMap<String, usize>,
    /// Names as of the last `sync_names`.
    durable: BTreeMap<String, usize>,
    /// The inode that was written last.
    last: usize,
}

/// What a power cut leaves of that which was not synced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Survives {
    /// Neither names nor bytes.
    Nothing,
    /// Both.
    Everything,
    /// Names, all bytes of other files, and half of those of the file that was written last.
    Half,
    /// Names, but of no file the bytes.
    Names,
    /// Names and lengths, with zeros for bytes.
    Zeros,
}

pub const CUTS: [Survives; 5] =
    [Survives::Nothing, Survives::Everything, Survives::Half, Survives::Names, Survives::Zeros];

impl State {
    fn after_cut(&self, survives: Survives) -> BTreeMap<String, Vec<u8>> {
        let names = if survives == Survives::Nothing { &self.durable } else { &self.live };
        let bytes = |at: usize| -> Vec<u8> {
            let i = &self.inodes[at];
            let half = i.durable + (i.bytes.len() - i.durable) / 2;
            match survives {
                Survives::Everything => i.bytes.clone(),
                Survives::Half if at == self.last => i.bytes[..half].to_vec(),
                Survives::Half => i.bytes.clone(),
                Survives::Nothing | Survives::Names => i.bytes[..i.durable].to_vec(),
                Survives::Zeros => {
                    let mut b = i.bytes[..i.durable].to_vec();
                    b.resize(i.bytes.len(), 0);
                    b
                }
            }
        };
        names.iter().map(|(n, at)| (n.clone(), bytes(*at))).collect()
    }

    fn holding(files: &BTreeMap<String, Vec<u8>>) -> State {
        let mut s = State::default();
        for (name, bytes) in files {
            s.live.insert(name.clone(), s.inodes.len());
            s.inodes.push(Inode { bytes: bytes.clone(), durable: bytes.len() });
        }
        s.durable = s.live.clone();
        s
    }
}

/// Counts the steps that change something durable, and stops at one.
#[derive(Default)]
pub struct Cue {
    pub step: u64,
    /// This step and all later ones fail; 0: none.
    stop_at: u64,
    /// A catalog transaction at `stop_at` is carried out before the power goes.
    done_first: bool,
    stopped: bool,
    /// Steps that were transactions of the catalog.
    pub transactions: BTreeSet<u64>,
    pub kinds: BTreeMap<&'static str, u64>,
}

impl Cue {
    /// Whether the next step may be carried out.
    fn go(&mut self, kind: &'static str) -> bool {
        self.step += 1;
        *self.kinds.entry(kind).or_default() += 1;
        self.stopped |= self.stop_at != 0 && self.step >= self.stop_at;
        !self.stopped
    }
}

fn power_cut() -> Error {
    Error::io("the simulated disk", std::io::Error::other("power cut"))
}

/// A disk in memory.
#[derive(Clone, Default)]
pub struct SimulatedDisk {
    state: Arc<Mutex<State>>,
    pub cue: Arc<Mutex<Cue>>,
    pub free: Arc<Mutex<Option<u64>>>,
}

impl SimulatedDisk {
    pub fn holding(files: &BTreeMap<String, Vec<u8>>) -> SimulatedDisk {
        SimulatedDisk { state: Arc::new(Mutex::new(State::holding(files))), ..SimulatedDisk::default() }
    }
    pub fn stopping_at(&self, step: u64, done_first: bool) {
        *self.cue.lock().unwrap() = Cue { stop_at: step, done_first, ..Cue::default() };
    }
    fn go(&self, kind: &'static str) -> Result<()> {
        if self.cue.lock().unwrap().go(kind) { Ok(()) } else { Err(power_cut()) }
    }
    pub fn after_cut(&self, survives: Survives) -> BTreeMap<String, Vec<u8>> {
        self.state.lock().unwrap().after_cut(survives)
    }
    pub fn total_bytes(&self) -> u64 {
        self.names().unwrap().iter().map(|(_, len)| len).sum()
    }
}

impl Disk for SimulatedDisk {
    fn create(&self, name: &str) -> Result<Box<dyn Growing>> {
        self.go("create")?;
        let mut s = self.state.lock().unwrap();
        let at = s.inodes.len();
        s.inodes.push(Inode::default());
        s.live.insert(name.to_string(), at);
        s.last = at;
        Ok(Box::new(SimulatedFile { disk: self.clone(), at }))
    }

    fn rename(&self, from: &str, to: &str) -> Result<()> {
        self.go("rename")?;
        let mut s = self.state.lock().unwrap();
        let at = s.live.remove(from).ok_or_else(power_cut)?;
        s.live.insert(to.to_string(), at);
        Ok(())
    }

    fn sync_names(&self) -> Result<()> {
        self.go("sync names")?;
        let mut s = self.state.lock().unwrap();
        s.durable = s.live.clone();
        Ok(())
    }

    fn remove(&self, name: &str) -> Result<()> {
        self.go("remove")?;
        let missing = || Error::io(name, std::io::ErrorKind::NotFound.into());
        self.state.lock().unwrap().live.remove(name).map(|_| ()).ok_or_else(missing)
    }

    fn names(&self) -> Result<Vec<(String, u64)>> {
        let s = self.state.lock().unwrap();
        Ok(s.live.iter().map(|(n, at)| (n.clone(), s.inodes[*at].bytes.len() as u64)).collect())
    }

    fn open(&self, name: &str, len: u64) -> Result<Finished> {
        let s = self.state.lock().unwrap();
        let at = s.live.get(name).ok_or_else(|| Error::corrupt(name, "file", "missing"))?;
        let bytes = &s.inodes[*at].bytes;
        if bytes.len() as u64 != len {
            return Err(Error::corrupt(name, "length", format!("{} bytes, {len} expected", bytes.len())));
        }
        Ok(Arc::new(bytes.clone()))
    }

    fn free_bytes(&self) -> Result<Option<u64>> {
        Ok(*self.free.lock().unwrap())
    }

    fn place(&self) -> String {
        "simulated disk".into()
    }
}

struct SimulatedFile {
    disk: SimulatedDisk,
    at: usize,
}

impl Growing for SimulatedFile {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        let go = self.disk.go("append");
        let mut s = self.disk.state.lock().unwrap();
        s.last = self.at;
        // A write that is cut off may have happened in part.
        let written = if go.is_ok() { bytes } else { &bytes[..bytes.len() / 2] };
        s.inodes[self.at].bytes.extend_from_slice(written);
        go
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        let s = self.disk.state.lock().unwrap();
        let from = offset as usize;
        buffer.copy_from_slice(&s.inodes[self.at].bytes[from..from + buffer.len()]);
        Ok(())
    }

    fn sync(&mut self) -> Result<()> {
        self.disk.go("sync")?;
        let mut s = self.disk.state.lock().unwrap();
        let all = s.inodes[self.at].bytes.len();
        s.inodes[self.at].durable = all;
        Ok(())
    }
}

/// The real catalog, whose transactions are steps of the same cue.
struct SteppedCatalog {
    inner: Sqlite,
    disk: SimulatedDisk,
}

impl SteppedCatalog {
    fn transaction(&mut self, kind: &'static str, act: impl FnOnce(&mut Sqlite) -> Result<()>) -> Result<()> {
        let (go, done_first) = {
            let mut cue = self.disk.cue.lock().unwrap();
            let go = cue.go(kind);
            let step = cue.step;
            cue.transactions.insert(step);
            (go, cue.done_first && step == cue.stop_at)
        };
        if go {
            return act(&mut self.inner);
        }
        if done_first {
            act(&mut self.inner)?;
        }
        Err(power_cut())
    }
}

impl Catalog for SteppedCatalog {
    fn constants(&self) -> Result<BTreeMap<String, String>> {
        self.inner.constants()
    }
    fn counters(&self) -> Result<Counters> {
        self.inner.counters()
    }
    fn latest(&self) -> Result<Option<Version>> {
        self.inner.latest()
    }
    fn version(&self, number: u64) -> Result<Option<Version>> {
        self.inner.version(number)
    }
    fn versions(&self) -> Result<Vec<Version>> {
        self.inner.versions()
    }
    fn operation(&self, id: &str) -> Result<Option<u64>> {
        self.inner.operation(id)
    }
    fn operations(&self) -> Result<Vec<(String, u64)>> {
        self.inner.operations()
    }
    fn files(&self, version: u64) -> Result<Vec<NamedFile>> {
        self.inner.files(version)
    }
    fn all_files(&self) -> Result<Vec<(u32, u64)>> {
        self.inner.all_files()
    }
    fn commit(&mut self, commit: &Commit) -> Result<()> {
        self.transaction("commit", |c| c.commit(commit))
    }
    fn prune(&mut self, versions: &[u64]) -> Result<()> {
        self.transaction("prune", |c| c.prune(versions))
    }
    fn is_current(&self) -> Result<bool> {
        self.inner.is_current()
    }
    fn check(&self) -> Result<Vec<String>> {
        self.inner.check()
    }
}

pub fn opened(root: &Path, disk: &SimulatedDisk) -> Db {
    let (path, inner) = (root.join("catalog.sqlite"), disk.clone());
    let opener = move |write: bool| -> Result<Box<dyn Catalog>> {
        let sqlite = if write { Sqlite::open(&path)? } else { Sqlite::open_read_only(&path)? };
        Ok(Box::new(SteppedCatalog { inner: sqlite, disk: inner.clone() }))
    };
    Db::open_with(root, Arc::new(disk.clone()), Arc::new(opener)).unwrap()
}
