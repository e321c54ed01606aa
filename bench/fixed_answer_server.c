/*
 * The bare minimum of a server: answers each segment with the same words, whatever was asked, and looks at nothing.
 *
 * No server that makes two system calls a request can be faster; what a generator reaches with it, it can reach.
 * Prints its port, and ends when its standard input closes.
 */
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

enum { BACKLOG = 128, EVENTS = 256, REQUEST = 12, COUNT_AT = 11, HEAD = 9 };

static void watch(int poll, int descriptor)
{
    struct epoll_event event = {.events = EPOLLIN, .data.fd = descriptor};
    epoll_ctl(poll, EPOLL_CTL_ADD, descriptor, &event);
}

static void answer(int descriptor)
{
    uint8_t request[REQUEST], told[HEAD + 2 * 255] = {0};
    if (recv(descriptor, request, REQUEST, 0) != REQUEST) {
        close(descriptor);
        return;
    }
    int words = request[COUNT_AT];
    memcpy(told, request, 8);
    told[4] = (3 + 2 * words) >> 8;
    told[5] = (3 + 2 * words) & 0xFF;
    told[8] = 2 * words;
    send(descriptor, told, HEAD + 2 * words, MSG_NOSIGNAL);
}

int main(void)
{
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t size = sizeof at;
    int listener = socket(AF_INET, SOCK_STREAM, 0), poll = epoll_create1(0), on = 1;
    if (bind(listener, (struct sockaddr *)&at, size) < 0 || listen(listener, BACKLOG) < 0)
        return 1;
    getsockname(listener, (struct sockaddr *)&at, &size);
    printf("%d\n", ntohs(at.sin_port));
    fflush(stdout);
    watch(poll, listener);
    watch(poll, STDIN_FILENO);
    for (;;) {
        struct epoll_event ready[EVENTS];
        int many = epoll_wait(poll, ready, EVENTS, -1);
        for (int i = 0; i < many; i++) {
            if (ready[i].data.fd == STDIN_FILENO)
                return 0;
            if (ready[i].data.fd != listener) {
                answer(ready[i].data.fd);
                continue;
            }
            int client = accept(listener, NULL, NULL);
            setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
            watch(poll, client);
        }
    }
}
