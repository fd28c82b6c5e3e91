//! The same on the scheduler of `shuttle`.
//!
//! Channels and tokens are tokio's own, as they ship, each with a point before what is done with it: what they do inside
//! is theirs to test, and is one step here.

use crate::service::ServiceError;
use crate::sync::point;
use std::future::Future;
use std::ops::{Deref, DerefMut};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

pub(in crate::service) use shuttle::future::{JoinError, JoinHandle};

/// Something of tokio's; to touch it is a point.
#[derive(Debug, Clone)]
pub(in crate::service) struct Pointed<T>(T);

impl<T> Deref for Pointed<T> {
    type Target = T;

    fn deref(&self) -> &T {
        point();
        &self.0
    }
}

impl<T> DerefMut for Pointed<T> {
    fn deref_mut(&mut self) -> &mut T {
        point();
        &mut self.0
    }
}

pub(in crate::service) type CancellationToken = Pointed<tokio_util::sync::CancellationToken>;

impl CancellationToken {
    pub(in crate::service) fn new() -> Self {
        Self(tokio_util::sync::CancellationToken::new())
    }

    pub(in crate::service) fn drop_guard(self) -> tokio_util::sync::DropGuard {
        self.0.drop_guard()
    }
}

pub(in crate::service) type OnceCell<T> = Pointed<tokio::sync::OnceCell<T>>;

impl<T> OnceCell<T> {
    pub(in crate::service) fn new() -> Self {
        Self(tokio::sync::OnceCell::new())
    }
}

impl<T> Default for OnceCell<T> {
    fn default() -> Self {
        Self::new()
    }
}

pub(in crate::service) mod mpsc {
    //! Many senders, one receiver.
    use super::{Pointed, point};
    pub(in crate::service) use tokio::sync::mpsc::error;

    pub(in crate::service) type UnboundedSender<T> = Pointed<tokio::sync::mpsc::UnboundedSender<T>>;
    pub(in crate::service) type UnboundedReceiver<T> = Pointed<tokio::sync::mpsc::UnboundedReceiver<T>>;

    impl<T> UnboundedReceiver<T> {
        /// Others may go on between this look and one that `select!` took before it.
        pub(in crate::service) async fn recv(&mut self) -> Option<T> {
            std::future::poll_fn(|context| {
                point();
                self.0.poll_recv(context)
            })
            .await
        }
    }

    pub(in crate::service) fn unbounded_channel<T>() -> (UnboundedSender<T>, UnboundedReceiver<T>) {
        let (sender, receiver) = tokio::sync::mpsc::unbounded_channel();
        (Pointed(sender), Pointed(receiver))
    }
}

pub(in crate::service) mod oneshot {
    //! One value, once.
    use super::{Context, Future, Pin, Pointed, Poll, point};

    pub(in crate::service) type Sender<T> = Pointed<tokio::sync::oneshot::Sender<T>>;
    pub(in crate::service) type Receiver<T> = Pointed<tokio::sync::oneshot::Receiver<T>>;

    pub(in crate::service) fn channel<T>() -> (Sender<T>, Receiver<T>) {
        let (sender, receiver) = tokio::sync::oneshot::channel();
        (Pointed(sender), Pointed(receiver))
    }

    impl<T> Sender<T> {
        pub(in crate::service) fn send(self, value: T) -> Result<(), T> {
            point();
            let sent = self.0.send(value);
            point();
            sent
        }
    }

    impl<T> Future for Receiver<T> {
        type Output = Result<T, tokio::sync::oneshot::error::RecvError>;

        fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
            point();
            Pin::new(&mut self.0).poll(context)
        }
    }
}

pub(in crate::service) mod watch {
    //! One value that changes.
    use super::Pointed;
    pub(in crate::service) use tokio::sync::watch::Receiver;

    pub(in crate::service) type Sender<T> = Pointed<tokio::sync::watch::Sender<T>>;

    impl<T> Sender<T> {
        pub(in crate::service) fn new(value: T) -> Self {
            Pointed(tokio::sync::watch::Sender::new(value))
        }
    }
}

/// The task may run, and others too, before its starter goes on.
pub(in crate::service) fn spawn<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> JoinHandle<T> {
    let task = shuttle::future::spawn(work);
    point();
    task
}

/// A task of its own: one that blocks holds up no other.
pub(in crate::service) fn spawn_blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> JoinHandle<T> {
    spawn(async move { work() })
}

/// Time does not pass here: others go on instead.
pub(in crate::service) async fn sleep(_duration: Duration) {
    shuttle::future::yield_now().await;
}

/// Does each work in a task of its own.
pub(in crate::service) struct Pool;

impl Pool {
    #[expect(clippy::unnecessary_wraps, reason = "threads may fail to start, tasks do not")]
    pub(in crate::service) fn new(_threads: usize) -> Result<Self, ServiceError> {
        Ok(Self)
    }

    #[expect(clippy::unused_self, reason = "the shape of the pool of threads")]
    pub(in crate::service) fn spawn(&self, work: impl FnOnce() + Send + 'static) {
        drop(spawn_blocking(work));
    }
}

/// Does the same with each item, one after the other.
pub(in crate::service) fn each<I, T>(items: Vec<I>, work: impl Fn(usize, I) -> T) -> Vec<T> {
    items.into_iter().enumerate().map(|(index, item)| work(index, item)).collect()
}
