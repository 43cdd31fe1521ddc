"""Who may talk to the viewer."""

import pytest

from stages.viewing.guard import COOKIE, Guard, new_token

HERE = {"Host": "127.0.0.1:8080"}


def socket(origin: str, host: str = "127.0.0.1:8080") -> dict[str, str]:
    return {"Host": host, "Upgrade": "websocket", "Origin": origin}


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:9", "[::1]:8080", "localhost"])
def test_this_machine_needs_no_token(host):
    assert Guard().refusal("/", {"Host": host}) == ""


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "[", "10.0.0.1:8080"])
def test_a_foreign_name_for_this_machine_is_refused(host):
    assert "own address" in Guard().refusal("/", {"Host": host})


def test_only_its_own_page_may_open_the_socket():
    guard = Guard()
    assert guard.refusal("/", socket("http://127.0.0.1:8080")) == ""
    for origin in ("http://evil.example", "http://127.0.0.1:9999", "null", ""):
        assert "another site" in guard.refusal("/", socket(origin))


def test_elsewhere_the_token_opens_the_page_and_its_cookie_the_socket():
    guard = Guard(new_token())
    away = {"Host": "10.0.0.1:8080"}
    assert "token is missing" in guard.refusal("/", away)
    assert "token is missing" in guard.refusal(f"/?token={guard.token}x", away)
    assert guard.refusal(f"/?token={guard.token}", away) == ""
    cookie = guard.cookie()
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    opened = socket("http://10.0.0.1:8080", "10.0.0.1:8080")
    assert "token is missing" in guard.refusal("/", opened)
    assert guard.refusal("/", opened | {"Cookie": cookie.partition(";")[0]}) == ""
    assert "token is missing" in guard.refusal("/", opened | {"Cookie": f"{COOKIE}=no"})


def test_tokens_are_not_guessed():
    assert len({new_token() for _ in range(50)}) == 50 and len(new_token()) >= 20
