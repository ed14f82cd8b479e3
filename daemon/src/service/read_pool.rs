//! Thread pool for clients' reading requests (reading the record, computing a plan).
//!
//! Acquisition, recording and stopping use the runtime's threads, which reading requests never occupy. Each user may
//! have a few requests, users are served in turn, and requests of disconnected callers are skipped.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Condvar, Mutex, PoisonError};

use dbus::Fault;
use tokio::sync::oneshot;

use crate::locked::locked;
use crate::panics::containment;
use crate::service::limit::{READ_JOBS, User};

/// Number of threads: two, so that one long request does not block all others.
const THREADS: usize = 2;

static POOL: Pool = Pool::new(THREADS);

/// Runs work for the current caller.
///
/// # Errors
/// [`Fault::LimitsExceeded`]: the user's limit or the total is reached. [`Fault::Failed`]: the work panicked, or no
/// thread could be started.
pub(crate) async fn read<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Fault> {
    let user = User::calling();
    let permit = READ_JOBS.take(user)?;
    let (answer, answered) = oneshot::channel();
    let job = move || {
        // held until the work is done, even if its caller has disconnected
        let _permit = permit;
        if !answer.is_closed() {
            let _ = answer.send(work());
        }
    };
    POOL.push(user, Box::new(job))?;
    answered.await.map_err(|_| {
        Fault::Failed("the daemon failed while it read; its journal says where".into())
    })
}

type Job = Box<dyn FnOnce() + Send>;

/// Threads that run jobs, one user after the other.
struct Pool {
    most: usize,
    waiting: Mutex<Waiting>,
    news: Condvar,
}

struct Waiting {
    queues: BTreeMap<User, VecDeque<Job>>,
    /// Users in order of service; each with queued jobs is here once.
    turns: VecDeque<User>,
    threads: usize,
    idle: usize,
}

impl Waiting {
    fn next(&mut self) -> Option<Job> {
        let user = self.turns.pop_front()?;
        let queue = self.queues.get_mut(&user)?;
        let job = queue.pop_front();
        match queue.is_empty() {
            true => drop(self.queues.remove(&user)),
            false => self.turns.push_back(user),
        }
        job
    }
}

impl Pool {
    const fn new(most: usize) -> Self {
        Self {
            most,
            waiting: Mutex::new(Waiting {
                queues: BTreeMap::new(),
                turns: VecDeque::new(),
                threads: 0,
                idle: 0,
            }),
            news: Condvar::new(),
        }
    }

    /// Queues a job after those of the same user.
    fn push(&'static self, user: User, job: Job) -> Result<(), Fault> {
        let mut waiting = locked(&self.waiting);
        if waiting.idle == 0 && waiting.threads < self.most {
            let started = std::thread::Builder::new()
                .name("reading".to_owned())
                .spawn(move || self.work());
            match started {
                Ok(_) => waiting.threads += 1,
                Err(cause) if waiting.threads == 0 => {
                    return Err(Fault::Failed(format!(
                        "the thread that reads cannot be started: {cause}"
                    )));
                }
                // running threads will take the job later
                Err(_) => {}
            }
        }
        let queue = waiting.queues.entry(user).or_default();
        queue.push_back(job);
        if queue.len() == 1 {
            waiting.turns.push_back(user);
        }
        drop(waiting);
        self.news.notify_one();
        Ok(())
    }

    fn work(&self) {
        let mut waiting = locked(&self.waiting);
        loop {
            if let Some(job) = waiting.next() {
                drop(waiting);
                // after a panic its caller gets no result, and reports that
                let _ = containment::run(job);
                waiting = locked(&self.waiting);
            } else {
                waiting.idle += 1;
                waiting = self
                    .news
                    .wait(waiting)
                    .unwrap_or_else(PoisonError::into_inner);
                waiting.idle -= 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use crate::service::read_pool::*;

    fn user(id: u32) -> User {
        User { id, trusted: false }
    }

    #[test]
    fn users_are_served_by_turns() {
        static ONE: Pool = Pool::new(1);
        let (go, wait) = mpsc::channel::<()>();
        let (done, order) = mpsc::channel();
        ONE.push(user(9), Box::new(move || wait.recv().unwrap()))
            .unwrap();
        for number in 0..3 {
            let done = done.clone();
            let job = move || done.send((1, number)).unwrap();
            ONE.push(user(1), Box::new(job)).unwrap();
        }
        let last = done.clone();
        ONE.push(user(2), Box::new(move || last.send((2, 0)).unwrap()))
            .unwrap();
        go.send(()).unwrap();
        drop(done);
        let order: Vec<(u32, u32)> = order.iter().collect();
        assert_eq!(order, [(1, 0), (2, 0), (1, 1), (1, 2)]);
    }

    #[tokio::test]
    async fn a_panic_costs_its_own_answer_only() {
        let failed = read(|| panic!("a test of the reading threads")).await;
        assert!(
            matches!(failed, Err::<(), _>(Fault::Failed(_))),
            "{failed:?}"
        );
        for number in 0..THREADS + 1 {
            assert_eq!(read(move || number).await.unwrap(), number);
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn one_user_has_eight_requests_and_others_have_theirs() {
        let (go, wait) = mpsc::channel::<()>();
        let wait = std::sync::Arc::new(Mutex::new(wait));
        let ask = |id| {
            let wait = std::sync::Arc::clone(&wait);
            let work = move || wait.lock().unwrap().recv().is_ok();
            tokio::spawn(user(id).calls(read(work)))
        };
        let mut requested: Vec<_> = (0..9).map(|_| ask(7)).collect();
        let refused = loop {
            if let Some(which) = requested
                .iter()
                .position(|requested| requested.is_finished())
            {
                break requested.swap_remove(which).await.unwrap();
            }
            tokio::task::yield_now().await;
        };
        assert!(
            matches!(&refused, Err(Fault::LimitsExceeded(why)) if why.starts_with("you have 8")),
            "{refused:?}"
        );
        requested.push(ask(8));
        for _ in 0..9 {
            go.send(()).unwrap();
        }
        for requested in requested {
            assert!(requested.await.unwrap().unwrap());
        }
    }
}
